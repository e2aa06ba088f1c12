"""Measures ghosts: cells of the map that stay occupied after a person left them."""

from __future__ import annotations

import math

import numpy as np

from edge.geometry import CameraModel, Grid
from edge.lab.sim.doors import SlidingDoor
from edge.lab.sim.people import PERSON_RADIUS_M, PeopledWorld
from edge.mapping.grid import RollingMap
from edge.mapping.layers import OCCUPIED

_LEFT_M = 0.15  # a person farther away than this has left the cell
_FREE_M = 0.15  # cells nearer to furniture are not judged: it may occupy them, too
_RANGE_M = 3.0  # farther floor is not judged
_SAME_M = 0.1  # largest difference between measured and expected depth of visible floor
_BORDER = 0.05  # of the image's width: a cell that is seen there may be half out of view


class GhostClock:
    """Longest time for which a cell that a person left stayed occupied in view.

    Cells that are closed only because an occupied one is near do not count: that one may be out of
    view. It needs odometry without drift, so that the service's map and the world agree.

    Attributes:
        longest_s: the result so far [s].
    """

    def __init__(self, world: PeopledWorld) -> None:
        self._world, self.longest_s = world, 0.0
        self._in_view_s: dict[tuple[int, int], float] = {}  # by cell that a person left
        self._is_judged = world.plan.clearance_m > _FREE_M  # by cell of the floor plan
        for door in world.doors:
            self._is_judged[_near_door(world.plan.grid, door)] = False

    def observe(
        self,
        grid: RollingMap,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        depth_m: np.ndarray,
        dt_s: float,
    ) -> None:
        """Judge the map after a tick: `depth_m` (h, w) is its image, `dt_s` the time of a step."""
        people, plan, cell_m = self._world.people, self._world.plan.grid, grid.resolution_m
        raw, size = grid.layers.raw, grid.window.n
        n = math.ceil(PERSON_RADIUS_M / cell_m)
        around = np.argwhere(np.ones((2 * n + 1, 2 * n + 1), bool)) - n
        for person in people:
            col, row = grid.window.cell_of(*person.xy_m.tolist())
            cells = around + np.array([row, col])
            xy_m = cell_m * (cells[:, ::-1] + 0.5)
            at = ((xy_m - plan.origin_xy_m) / plan.resolution_m).astype(np.int64)
            at = np.clip(at[:, ::-1], 0, np.array(self._is_judged.shape) - 1)
            inside = np.hypot(*(xy_m - person.xy_m).T) < PERSON_RADIUS_M
            inside &= self._is_judged[at[:, 0], at[:, 1]]
            self._in_view_s.update(dict.fromkeys(map(tuple, cells[inside].tolist()), 0.0))
        if not self._in_view_s:
            return
        cells = np.array(list(self._in_view_s))
        xy_m = cell_m * (cells[:, ::-1] + 0.5)
        apart_m = np.hypot(*(xy_m - np.array([p.xy_m for p in people])[:, None]).T).min(axis=1)
        has_left = apart_m - PERSON_RADIUS_M >= _LEFT_M
        is_free = raw[cells[:, 0] % size, cells[:, 1] % size] < OCCUPIED
        for cell in map(tuple, cells[has_left & is_free].tolist()):
            del self._in_view_s[cell]
        in_view = has_left & ~is_free & _shows_floor(camera, T_map_camera, xy_m, depth_m)
        for cell in map(tuple, cells[in_view].tolist()):
            self._in_view_s[cell] += dt_s
            self.longest_s = max(self.longest_s, self._in_view_s[cell])


def _near_door(plan: Grid, door: SlidingDoor) -> np.ndarray:
    """Return (rows, columns) bool: cells of a floor plan that a door may occupy in the map."""
    indices = np.indices(plan.cells.shape)
    dx, dy = (plan.centres_m(indices[0], indices[1]) - door.jamb_m).transpose(2, 0, 1)
    along, across = dx * door.along[0] + dy * door.along[1], dy * door.along[0] - dx * door.along[1]
    return (along > -_FREE_M) & (along < door.width_m + _FREE_M) & (np.abs(across) < _FREE_M)


def _shows_floor(
    camera: CameraModel, T_map_camera: np.ndarray, xy_m: np.ndarray, depth_m: np.ndarray
) -> np.ndarray:
    """Return (n,) bool: the image shows the floor at these points, (n, 2) in `map`."""
    floor_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
    x, y, z = ((floor_m - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]).T
    near = (z > 0.1) & (z < _RANGE_M)
    z = np.where(near, z, 1.0)
    u = np.rint(camera.fx_px * x / z + camera.cx_px).astype(np.int64)
    v = np.rint(camera.fy_px * y / z + camera.cy_px).astype(np.int64)
    height, width = depth_m.shape
    border = _BORDER * width
    near &= (v >= 0) & (v < height) & (u >= border) & (u < width - border)
    u, v = np.where(near, u, 0), np.where(near, v, 0)
    return near & (np.abs(depth_m[v, u] - z) < _SAME_M)
