"""What the rolling map hands out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """What one update did.

    Attributes:
        changed: (ix0, iy0, ix1, iy1), half-open rectangle of world cells (x = ix * resolution)
            whose published state changed; all zero when none did.
        rolled: whether the window moved.
        floor_z_m: height of the floor under the robot in `map`; NaN until it was seen.
        floor_seen: whether this update saw it.
        floor_missing: whether there was no floor where the base and its sensor's mount say that it
            must be, but ground far below; then nothing but the footprint was mapped.
    """

    changed: tuple[int, int, int, int]
    rolled: bool
    floor_z_m: float = math.nan
    floor_seen: bool = False
    floor_missing: bool = False


@dataclass(slots=True, eq=False)
class Frontiers:
    """Frontier-based target points: parallel arrays, the first `n` entries count.

    Attributes:
        xy_m: (capacity, 2) float32 in `map`, centres of frontier cells.
        cells: (capacity,) int32, size of the cluster.
        cluster: (capacity,) int32, equal for the samples of one cluster.
    """

    n: int
    xy_m: np.ndarray
    cells: np.ndarray
    cluster: np.ndarray
