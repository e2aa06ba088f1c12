"""A second look at an object that only one viewpoint has shown so far."""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.perception.tracking.viewpoints import is_other_view
from edge.types import Instance

_ANGLES_RAD = tuple(math.radians(a) for a in (45, -45, 70, -70, 100, -100, 140, -140, 180))
"""Directions of the new viewpoint, seen from the object, against the direction of the robot."""
_FARTHER_M = (0.0, 0.6, 1.2)
"""Distances of the new viewpoint beyond that of the robot from the object, tried in this order."""
_NEAREST_M = 0.9
"""Least distance of the new viewpoint from the object's centre: nearer, it fills the image."""
_INFLATED_M = 0.5  # around an object, cells are closed by this much
_SNAP_M = 0.3  # largest distance of a goal from a viewpoint that is not free


def second_viewpoint(grid: RollingMap, pose: SE2, instance: Instance) -> SE2 | None:
    """Return the nearest pose from which an object looks different; None if there is none.

    The pose is free and reachable, faces the object, and has a free line to its surface.

    Args:
        grid: the map.
        pose: pose of the robot, which is next to the object.
        instance: the object.
    """
    x_m, y_m = map(float, instance.center_m[:2])
    bearing_rad = math.atan2(pose.y_m - y_m, pose.x_m - x_m)
    away_m = max(math.hypot(pose.x_m - x_m, pose.y_m - y_m), _NEAREST_M)
    surface_m = instance.points_m[:, :2] - (x_m, y_m)
    extent_m = float(np.hypot(*surface_m.T).max(initial=0.0)) + _INFLATED_M
    best: tuple[float, SE2] | None = None
    for farther_m in _FARTHER_M:
        for angle_rad in (*_ANGLES_RAD, 0.0):
            radius_m, turned_rad = away_m + farther_m, bearing_rad + angle_rad
            at = x_m + radius_m * math.cos(turned_rad), y_m + radius_m * math.sin(turned_rad)
            cell = grid.travel_cost.nearest(*at, _SNAP_M)
            if cell is None or not is_other_view((x_m, y_m), (pose.x_m, pose.y_m), cell[:2]):
                continue
            path_m = grid.travel_cost.distance_m(cell[0], cell[1])
            if not math.isfinite(path_m) or (best is not None and path_m >= best[0]):
                continue
            if _is_clear(grid, cell[:2], (x_m, y_m), extent_m):
                facing_rad = math.atan2(y_m - cell[1], x_m - cell[0])
                best = path_m, SE2(cell[0], cell[1], facing_rad)
        if best is not None:
            break
    return None if best is None else best[1]


def _is_clear(
    grid: RollingMap, from_m: tuple[float, float], to_m: tuple[float, float], rest_m: float
) -> bool:
    """Return True if no cell on the line is occupied; its last `rest_m` do not count."""
    length_m = math.dist(from_m, to_m)
    steps = int(max(0.0, length_m - rest_m) / grid.resolution_m)
    dx, dy = ((b - a) * grid.resolution_m / length_m for a, b in zip(from_m, to_m, strict=True))
    return all(grid.state_at(from_m[0] + k * dx, from_m[1] + k * dy) <= 0 for k in range(steps))
