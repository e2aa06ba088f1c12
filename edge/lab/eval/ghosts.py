"""Measures ghosts: cells of the map that stay occupied after a person left them."""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import CameraModel
from edge.lab.sim.people import PERSON_RADIUS_M, PeopledWorld, person_clearance_m
from edge.mapping.grid import RollingMap
from edge.mapping.layers import OCCUPIED

_LEFT_M = 0.15  # a person farther away than this has left the cell
_FREE_M = 0.15  # cells nearer to furniture are not judged: it may occupy them, too
_RANGE_M = 3.0  # farther floor is not judged
_SAME_M = 0.1  # largest difference between measured and expected depth of visible floor


class GhostClock:
    """Longest time for which a cell that a person left stayed occupied in view.

    Cells that are closed only because an occupied one is near do not count: that one may be out of
    view. It needs odometry without drift, so that the service's map and the world agree.

    Args:
        world: the world with its people.

    Attributes:
        longest_s: the result so far [s].
    """

    def __init__(self, world: PeopledWorld) -> None:
        self._world, self.longest_s = world, 0.0
        self._in_view_s: dict[tuple[int, int], float] = {}  # by cell that a person left

    def observe(
        self,
        grid: RollingMap,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        depth_m: np.ndarray,
        dt_s: float,
    ) -> None:
        """Judge the map after a tick: `depth_m` (h, w) is its image, `dt_s` the time of a step."""
        people, plan, cell_m = self._world.people, self._world.plan, grid.resolution_m
        raw, size = grid.layers.raw, grid.window.n
        n = math.ceil(PERSON_RADIUS_M / cell_m)
        for person in people:
            col, row = grid.window.cell_of(*person.xy_m.tolist())
            for dr in range(-n, n + 1):
                for dc in range(-n, n + 1):
                    x_m, y_m = cell_m * (col + dc + 0.5), cell_m * (row + dr + 0.5)
                    inside = math.dist(person.xy_m, (x_m, y_m)) < PERSON_RADIUS_M
                    cell = plan.grid.cell_of(x_m, y_m)
                    if inside and cell is not None and plan.clearance_m[cell] > _FREE_M:
                        self._in_view_s[row + dr, col + dc] = 0.0
        R, at = T_map_camera[:3, :3], T_map_camera[:3, 3]
        for (row, col), seconds in list(self._in_view_s.items()):
            x_m, y_m = cell_m * (col + 0.5), cell_m * (row + 0.5)
            if person_clearance_m(people, x_m, y_m) < _LEFT_M:
                continue
            if raw[row % size, col % size] < OCCUPIED:
                del self._in_view_s[row, col]
            elif _shows_floor(camera, R.T @ (np.array([x_m, y_m, 0.0]) - at), depth_m):
                self._in_view_s[row, col] = seconds + dt_s
                self.longest_s = max(self.longest_s, seconds + dt_s)


def _shows_floor(camera: CameraModel, point_m: np.ndarray, depth_m: np.ndarray) -> bool:
    """Return True if the image shows this point of the floor, given in the camera's frame."""
    x, y, z = point_m.tolist()
    if not 0.1 < z < _RANGE_M:
        return False
    u = round(camera.fx_px * x / z + camera.cx_px)
    v = round(camera.fy_px * y / z + camera.cy_px)
    inside = 0 <= v < depth_m.shape[0] and 0 <= u < depth_m.shape[1]
    return inside and abs(float(depth_m[v, u]) - z) < _SAME_M
