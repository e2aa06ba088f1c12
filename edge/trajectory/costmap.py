"""From an occupancy grid to what each cell costs to drive over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import Grid
from edge.trajectory.kernels import MAX_SIDE

OCCUPIED = 50  # cells from here on are closed
H_PAYS = 3.0  # a heuristic below a third of the mean weight costs more than it saves
UNIT = 16  # weight of a free cell far from obstacles; weights are UNIT times the cost factor


@dataclass(frozen=True, slots=True, eq=False)
class CostMap:
    """Integer traversal weights over a piece of the `map` frame.

    Attributes:
        weight: (h + 2, w + 2) uint8 with a border of zeros; 0 = not to be entered. Entering a
            cell costs weight / unit times the length of the step.
        grid: the weights inside the border.
        min_weight: the least weight above 0.
        h_weight: what the search's heuristic takes for every cell ahead: `min_weight`, or 0
            (no heuristic) where weights are so much higher that it would not pay.
        unit: the weight whose cost is 1 a metre.
    """

    weight: np.ndarray
    grid: Grid
    min_weight: int
    h_weight: int
    unit: int = UNIT

    @property
    def width(self) -> int:
        """Cells in a row, border included."""
        return self.weight.shape[1]

    def grid_of(self, xy_m: np.ndarray) -> np.ndarray:
        """Points (…, 2) in cells of `weight`: cell (r, c) spans [c, c + 1) x [r, r + 1)."""
        return self.grid.of_metres(xy_m) + 1.0

    def metres_of(self, grid_xy: np.ndarray) -> np.ndarray:
        """The inverse of `grid_of`."""
        return self.grid.to_metres(grid_xy - 1.0)

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """(row, column) in `weight`; None outside the map."""
        inside = self.grid.cell_of(x_m, y_m)
        return None if inside is None else (inside[0] + 1, inside[1] + 1)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Whether the cell may be entered; False outside the map."""
        cell = self.cell_of(x_m, y_m)
        return cell is not None and self.weight[cell] != 0


def from_weights(grid: Grid, unit: int = UNIT) -> CostMap:
    """A cost map of given weights.

    Args:
        grid: uint8, 0 = not to be entered.

    Raises:
        ValueError: not a grid of uint8, or a side too long for the search.
    """
    weights = grid.cells
    if weights.ndim != 2 or weights.dtype != np.uint8:
        raise ValueError(f"weights: expected (h, w) uint8, got {weights.shape} {weights.dtype}")
    if max(weights.shape) + 2 > MAX_SIDE:
        raise ValueError(f"weights: {weights.shape} is over {MAX_SIDE - 2} cells a side")
    padded = np.pad(weights, 1)
    counts = cv2.calcHist([padded], [0], None, [256], [0, 256]).ravel()[1:]
    cells = counts.sum()
    least = int(np.flatnonzero(counts)[0]) + 1 if cells else 1
    mean = float(counts @ np.arange(1, 256)) / max(cells, 1.0)
    h_weight = least if mean <= H_PAYS * least else 0
    return CostMap(padded, replace(grid, cells=padded[1:-1, 1:-1]), least, h_weight, unit)


def from_occupancy(
    grid: Grid,
    *,
    clearance_m: float = 0.0,
    near_m: float = 0.4,
    near_cost: float = 4.0,
    unknown_cost: float | None = 3.0,
) -> CostMap:
    """Weights of an occupancy grid: obstacles closed, cells near them dearer.

    The cost factor is 1 on free and `unknown_cost` on unknown cells, plus
    near_cost (1 - d / near_m)^2 within near_m of the closed cells.

    Args:
        grid: an occupancy grid; 50 and above count as occupied.
        clearance_m: closes cells whose centre is nearer than this to an occupied cell's centre;
            0 where the map is inflated already.
        unknown_cost: cost factor of the unknown; None closes it.

    Raises:
        ValueError: not a grid of int8, or a side too long for the search.
    """
    cells, resolution_m = grid.cells, grid.resolution_m
    if cells.ndim != 2 or cells.dtype != np.int8:
        raise ValueError(f"cells: expected (h, w) int8, got {cells.shape} {cells.dtype}")
    if cells.size == 0:
        return from_weights(replace(grid, cells=np.zeros((0, 0), np.uint8)))
    closed = cells >= OCCUPIED
    if not closed.any():
        distance = np.full(cells.shape, near_m + clearance_m, np.float32)
    else:
        open_mask = np.logical_not(closed).view(np.uint8)
        distance = cv2.distanceTransform(open_mask, cv2.DIST_L2, 5)
        distance *= resolution_m
    # Two tables, for known and unknown cells, over the distance in sixteenths of a cell.
    step_m = resolution_m / 16
    entries = int((clearance_m + near_m) / step_m) + 2
    at_m = np.arange(entries) * step_m
    near = near_cost * np.clip(1.0 - (at_m - clearance_m) / near_m, 0.0, 1.0) ** 2
    table = np.stack([1.0 + near, (unknown_cost or 1.0) + near]) * UNIT
    table = np.clip(np.rint(table), 1, 255).astype(np.uint8)
    table[:, at_m < max(clearance_m, step_m)] = 0
    if unknown_cost is None:
        table[1] = 0
    index = np.minimum(distance / np.float32(step_m), entries - 1).astype(np.int32)
    index += (cells < 0) * np.int32(entries)
    return from_weights(replace(grid, cells=table.ravel()[index]))
