"""What the rolling map hands out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """What one update did.

    Attributes:
        changed: (ix0, iy0, ix1, iy1), half-open rectangle of world cells (x = ix * resolution)
            whose published state changed; all zero when none did.
        n_points: points or pixels that were used.
        n_dropped: pixels or points without a valid return (NaN, zero, inf, too near).
        n_new_obstacles, n_cleared: cells, before inflation.
        rolled: whether the window moved.
    """

    changed: tuple[int, int, int, int]
    n_points: int
    n_dropped: int
    n_new_obstacles: int
    n_cleared: int
    rolled: bool


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


@dataclass(frozen=True, slots=True, eq=False)
class OccupancySnapshot:
    """A copy of the explored part of the map.

    Attributes:
        cells: (h, w) int8, row = y, -1 unknown, 0 free, 100 occupied (inflated); where it was
            asked for, another value for cells that are closed only by inflation.
        origin_xy_m: lower-left corner of cell (0, 0) in `map`.
    """

    cells: np.ndarray
    origin_xy_m: tuple[float, float]
    resolution_m: float

    @property
    def known_m2(self) -> float:
        """Area of the cells that are known."""
        return float(np.count_nonzero(self.cells >= 0)) * self.resolution_m**2
