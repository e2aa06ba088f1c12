"""Computes shortest driving distances on a simulated world's floor plan, which SPL needs."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from edge.jit import jit
from edge.lab.sim.base import FloorPlan, WorldObject, box_distances_m


def distance_field(
    plan: FloorPlan, objects: list[WorldObject], robot_radius_m: float, within_m: float
) -> np.ndarray:
    """Return the distance that a robot must drive to come near any of the objects.

    Near means within `within_m` of an object's footprint. Paths are shortest over the 8-connected
    raster of places where the robot fits.

    Returns:
        (rows, columns) float64 in metres on the plan's raster; inf if there is no path.
    """
    return distance_to(plan, near(plan, objects, robot_radius_m, within_m), robot_radius_m)


def distance_to(plan: FloorPlan, ends: np.ndarray, robot_radius_m: float) -> np.ndarray:
    """Return the distance that a robot must drive to any place where `ends` is True.

    `ends` is (rows, columns) bool; the result is as of `distance_field`.
    """
    free = plan.clearance_m > robot_radius_m
    distance = np.where(ends, 0.0, np.inf)
    while relax(free, distance):  # until nothing changes
        pass
    return distance * plan.grid.resolution_m


def near(
    plan: FloorPlan, objects: list[WorldObject], robot_radius_m: float, within_m: float
) -> np.ndarray:
    """Return (rows, columns) bool: True where the robot fits and is near any of the objects.

    Near means within `within_m` of an object's footprint.
    """
    free, cell_m = plan.clearance_m > robot_radius_m, plan.grid.resolution_m
    found = np.zeros(free.shape, bool)
    for item in objects:
        reach_m = within_m + 0.5 * math.hypot(*item.size_m[:2]) + cell_m
        low = plan.grid.to_cells(np.array(item.center_m[:2]) - reach_m)
        high = plan.grid.to_cells(np.array(item.center_m[:2]) + reach_m)
        left, bottom = np.maximum(low.astype(int), 0)
        right, top = np.maximum(high.astype(int) + 1, 0)
        row, col = np.nonzero(free[bottom:top, left:right])
        row, col = row + bottom, col + left
        close = _is_near(item, plan.grid.centres_m(row, col), within_m)
        found[row[close], col[close]] = True
    return found


def _is_near(item: WorldObject, xy_m: np.ndarray, within_m: float) -> np.ndarray:
    """Return (n,) bool for (n, 2) places: True within `within_m` of the object's footprint."""
    if item.footprint_m is not None:
        away_m, _ = cKDTree(item.footprint_m).query(xy_m, distance_upper_bound=within_m)
        return np.isfinite(away_m)
    return box_distances_m(xy_m, item.center_m, item.size_m, item.yaw_rad) <= within_m


def value_at(plan: FloorPlan, field: np.ndarray, x_m: float, y_m: float) -> float:
    """Return the value of a field on the plan's raster at a point; inf outside."""
    cell = plan.grid.cell_of(x_m, y_m)
    return math.inf if cell is None else float(field[cell])


@jit
def relax(free, distance):
    """Relax every free cell from its neighbours, in both directions. Return True if any changed.

    `free` is (rows, columns) bool; `distance`, float64 in cells, is changed in place.
    """
    rows, cols = free.shape
    changed = False
    # One sweep from the first cell to the last, then one back.
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
