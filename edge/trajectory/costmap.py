"""Cost maps: the cost of driving over each cell, from an occupancy grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import Grid
from edge.trajectory.kernels import MAX_SIDE

OCCUPIED = 50  # occupancy from which a cell is blocked
# Largest ratio of the mean weight to the smallest at which A*'s heuristic is used. Above it, the
# heuristic costs more time than it saves.
MAX_MEAN_RATIO = 3.0
UNIT = 16  # weight of a free cell far from obstacles; weights are UNIT times the cost factor


@dataclass(frozen=True, slots=True, eq=False)
class CostMap:
    """Integer weights of the cells of a rectangle in `map`.

    Attributes:
        weight: (h + 2, w + 2) uint8 with a border of zeros; 0 = blocked. Entering a cell costs
            weight / unit times the length of the step.
        grid: the weights inside the border.
        min_weight: the smallest weight above 0.
        h_weight: weight that the heuristic of the search assumes for each cell: `min_weight`, or 0
            (no heuristic) if the mean weight is so high that the heuristic would not pay.
        unit: the weight that costs 1 per metre.
    """

    weight: np.ndarray
    grid: Grid
    min_weight: int
    h_weight: int
    unit: int = UNIT

    @property
    def width(self) -> int:
        """Number of cells in a row, border included."""
        return self.weight.shape[1]

    def grid_of(self, xy_m: np.ndarray) -> np.ndarray:
        """Convert points (…, 2) from `map` to cells of `weight`.

        Cell (r, c) spans [c, c + 1) x [r, r + 1).
        """
        return self.grid.to_cells(xy_m) + 1.0

    def metres_of(self, grid_xy: np.ndarray) -> np.ndarray:
        """Convert points (…, 2) from cells of `weight` to `map`: the inverse of `grid_of`."""
        return self.grid.to_metres(grid_xy - 1.0)

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """Return (row, column) in `weight`, or None outside the map."""
        inside = self.grid.cell_of(x_m, y_m)
        return None if inside is None else (inside[0] + 1, inside[1] + 1)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Return True if the cell is not blocked; False outside the map."""
        cell = self.cell_of(x_m, y_m)
        return cell is not None and self.weight[cell] != 0


def from_weights(grid: Grid, unit: int = UNIT) -> CostMap:
    """Make a cost map from given weights.

    Args:
        grid: uint8, 0 = blocked.
        unit: the weight that costs 1 per metre.

    Raises:
        ValueError: the grid is not uint8, or a side is too long for the search.
    """
    weights = grid.cells
    if weights.ndim != 2 or weights.dtype != np.uint8:
        raise ValueError(f"weights: expected (h, w) uint8, got {weights.shape} {weights.dtype}")
    if max(weights.shape) + 2 > MAX_SIDE:
        raise ValueError(f"weights: {weights.shape} is over {MAX_SIDE - 2} cells a side")
    padded = np.pad(weights, 1)
    counts = cv2.calcHist([padded], [0], None, [256], [0, 256]).ravel()[1:]
    cells = counts.sum()
    min_weight = int(np.flatnonzero(counts)[0]) + 1 if cells else 1
    mean = float(counts @ np.arange(1, 256)) / max(cells, 1.0)
    h_weight = min_weight if mean <= MAX_MEAN_RATIO * min_weight else 0
    return CostMap(padded, replace(grid, cells=padded[1:-1, 1:-1]), min_weight, h_weight, unit)


def from_occupancy(
    grid: Grid,
    *,
    clearance_m: float = 0.0,
    near_m: float = 0.4,
    near_cost: float = 4.0,
    unknown_cost: float | None = 3.0,
) -> CostMap:
    """Make a cost map from an occupancy grid: obstacles are blocked, cells near them cost more.

    The cost factor is 1 on free and `unknown_cost` on unknown cells, plus near_cost (1 - d /
    near_m)^2 within `near_m` of the blocked cells.

    Args:
        grid: int8 occupancy; 50 and above count as occupied.
        clearance_m: blocks cells whose centre is nearer than this to the centre of an occupied
            cell; 0 if the map is inflated already.
        near_m: distance from blocked cells within which the cost is higher.
        near_cost: cost factor that is added next to a blocked cell.
        unknown_cost: cost factor of unknown cells; None blocks them.

    Raises:
        ValueError: the grid is not int8, or a side is too long for the search.
    """
    cells, resolution_m = grid.cells, grid.resolution_m
    if cells.ndim != 2 or cells.dtype != np.int8:
        raise ValueError(f"cells: expected (h, w) int8, got {cells.shape} {cells.dtype}")
    if cells.size == 0:
        return from_weights(replace(grid, cells=np.zeros((0, 0), np.uint8)))
    blocked = cells >= OCCUPIED
    if not blocked.any():
        distance = np.full(cells.shape, near_m + clearance_m, np.float32)
    else:
        free_mask = np.logical_not(blocked).view(np.uint8)
        distance = cv2.distanceTransform(free_mask, cv2.DIST_L2, 5)
        distance *= resolution_m
    # One table of weights for known and one for unknown cells, by distance in 1/16 cells.
    step_m = resolution_m / 16
    entries = int((clearance_m + near_m) / step_m) + 2
    at_m = np.arange(entries) * step_m
    near = near_cost * np.clip(1.0 - (at_m - clearance_m) / max(near_m, step_m), 0.0, 1.0) ** 2
    table = np.stack([1.0 + near, (unknown_cost or 1.0) + near]) * UNIT
    table = np.clip(np.rint(table), 1, 255).astype(np.uint8)
    table[:, at_m < max(clearance_m, step_m)] = 0
    if unknown_cost is None:
        table[1] = 0
    index = np.minimum(distance / np.float32(step_m), entries - 1).astype(np.int32)
    index += (cells < 0) * np.int32(entries)  # unknown cells: second row of the table
    return from_weights(replace(grid, cells=table.ravel()[index]))
