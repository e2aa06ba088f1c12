"""Shortest distances over a simulated world's floor plan: the reference of SPL."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from edge.sim.base import FloorPlan, WorldObject


def distance_field(
    plan: FloorPlan, objects: list[WorldObject], robot_radius_m: float, within_m: float
) -> np.ndarray:
    """Metres that a robot must drive from anywhere to come within `within_m` of any of the
    objects' footprints.

    Shortest paths over the 8-connected raster of places where the robot fits.

    Returns:
        (rows, columns) float64 on the plan's raster; inf where there is no way.
    """
    free = plan.clearance_m > robot_radius_m
    distance = np.full(free.shape, np.inf)
    for item in objects:
        reach_m = within_m + 0.5 * math.hypot(*item.size_m[:2]) + plan.cell_m
        low = (np.array(item.center_m[:2]) - reach_m - plan.origin_m) / plan.cell_m
        high = (np.array(item.center_m[:2]) + reach_m - plan.origin_m) / plan.cell_m
        rows = range(max(int(low[1]), 0), min(int(high[1]) + 1, free.shape[0]))
        for row in rows:
            y = plan.origin_m[1] + (row + 0.5) * plan.cell_m
            for col in range(max(int(low[0]), 0), min(int(high[0]) + 1, free.shape[1])):
                x = plan.origin_m[0] + (col + 0.5) * plan.cell_m
                if free[row, col] and item.distance_m(x, y) <= within_m:
                    distance[row, col] = 0.0
    while sweep(free, distance):
        pass
    return distance * plan.cell_m


def at(plan: FloorPlan, field: np.ndarray, x_m: float, y_m: float) -> float:
    """The value of a field on the plan's raster at a point; inf outside."""
    row = math.floor((y_m - plan.origin_m[1]) / plan.cell_m)
    col = math.floor((x_m - plan.origin_m[0]) / plan.cell_m)
    inside = 0 <= row < field.shape[0] and 0 <= col < field.shape[1]
    return float(field[row, col]) if inside else math.inf


@njit(nogil=True, cache=True)
def sweep(free, distance):
    """Relax every free cell from its neighbours, there and back; whether anything changed.

    Args:
        free: (rows, columns) bool.
        distance: (rows, columns) float64 in cells, in place.
    """
    rows, cols = free.shape
    changed = False
    for k in range(2 * rows):
        row = k if k < rows else 2 * rows - 1 - k
        for c in range(cols):
            col = c if k < rows else cols - 1 - c
            if not free[row, col]:
                continue
            best = distance[row, col]
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for q in range(max(col - 1, 0), min(col + 2, cols)):
                    step = 1.0 if r == row or q == col else math.sqrt(2.0)
                    best = min(best, distance[r, q] + step)
            if best < distance[row, col] - 1e-9:
                distance[row, col] = best
                changed = True
    return changed
