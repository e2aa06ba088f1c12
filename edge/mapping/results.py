"""Results of the rolling map: updates and frontiers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """Result of one update.

    Attributes:
        changed: (ix0, iy0, ix1, iy1), half-open rectangle of world cells (x = ix * resolution)
            whose published state changed; all zero if none did.
        rolled: True if the window moved.
        floor_z_m: height of the floor under the robot in `map`; NaN until it was seen.
        floor_seen: True if this update saw the floor.
        floor_missing: True if there is no floor at the height of the base, but ground far below.
            Then only the footprint was mapped.
    """

    changed: tuple[int, int, int, int]
    rolled: bool
    floor_z_m: float = math.nan
    floor_seen: bool = False
    floor_missing: bool = False


@dataclass(slots=True, eq=False)
class Frontiers:
    """Target points on frontiers: parallel arrays, of which the first `n` entries count.

    Attributes:
        n: number of target points.
        xy_m: (capacity, 2) float32 in `map`, centres of frontier cells.
        cells: (capacity,) int32, size of the cluster.
        cluster: (capacity,) int32, id of the cluster; equal for its target points.
    """

    n: int
    xy_m: np.ndarray
    cells: np.ndarray
    cluster: np.ndarray
