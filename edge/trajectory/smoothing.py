"""Path smoothing: from a path of cells to a path that a robot can follow."""

from __future__ import annotations

import math

import numpy as np

from edge.trajectory import kernels
from edge.trajectory.costmap import CostMap


def smooth(costmap: CostMap, path_m: np.ndarray, spacing_m: float = 0.05) -> np.ndarray:
    """Straighten a path if the map allows, then space its points evenly.

    Args:
        costmap: the weights.
        path_m: (n, 2) float64 in `map`.
        spacing_m: largest distance between two points.

    Returns:
        (k, 2) float64 with the same ends. It enters blocked cells only if `path_m` does, and costs
        no more.
    """
    if len(path_m) < 2:
        return path_m
    grid = costmap.grid_of(path_m)
    out = np.empty_like(grid)
    kept = kernels.shortcut(costmap.weight, grid, out)
    corners = costmap.metres_of(out[:kept])
    corners[0], corners[-1] = path_m[0], path_m[-1]
    return resample(corners, spacing_m)


def resample(path_m: np.ndarray, spacing_m: float) -> np.ndarray:
    """Add points to a polyline (n, 2) so that they are at most `spacing_m` apart.

    Corners and ends are kept.
    """
    legs = np.hypot(*np.diff(path_m, axis=0).T)
    pieces = [path_m[:1]]
    for start, end, length in zip(path_m[:-1], path_m[1:], legs, strict=True):
        if length > 0:
            fractions = np.arange(1, math.ceil(length / spacing_m) + 1)[:, None]
            pieces.append(start + (end - start) * fractions / len(fractions))
    return np.concatenate(pieces)


def line_is_free(
    costmap: CostMap, from_xy_m: tuple[float, float], to_xy_m: tuple[float, float]
) -> bool:
    """Return True if a straight line enters no blocked cell and stays in the map."""
    (x0, y0), (x1, y1) = costmap.grid_of(np.array([from_xy_m, to_xy_m]))
    return kernels.line_cost(costmap.weight, x0, y0, x1, y1) >= 0


def polyline_cost_m(costmap: CostMap, path_m: np.ndarray) -> float:
    """Return the cost of a polyline in metres of free ground; inf if it enters a blocked cell."""
    grid = costmap.grid_of(path_m)
    cost = kernels.polyline_cost(costmap.weight, grid)
    return cost * costmap.grid.resolution_m / costmap.unit if cost >= 0 else math.inf
