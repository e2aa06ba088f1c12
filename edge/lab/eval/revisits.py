"""Measures the floor that a mission's searches see twice, by ground truth.

A leg is the pursuit of one target. The robot searches until it knows the target's place. Floor that
it sees during a search counts as revisited if an earlier leg had seen it.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from edge.config import Config
from edge.jit import jit
from edge.lab.sim.base import FloorPlan, World, objects_named

CELL_M = 0.1  # side of a cell
SAME_M = 0.5  # a known place within this distance of an object is that of the object
NEW, BEFORE, NOW = 0, 1, 2
"""State of a cell: NEW if it was never seen, else bits: seen before this leg, seen in this leg."""


class RevisitCounter:
    """Counter of revisited floor over the legs of a mission.

    Attributes:
        revisited_m2: area seen in searches that earlier legs had already seen [m²].
    """

    def __init__(self, config: Config, world: World, range_m: float) -> None:
        camera = config.sensors.camera
        self.revisited_m2 = 0.0
        self._world = world
        self._floor = SeenFloor(world.plan, math.radians(camera.hfov_deg), range_m)
        self._leg: Hashable | None = None
        self._is_place_known = False

    def update(
        self, leg: Hashable, target: str, known_xy_m: np.ndarray, x_m: float, y_m: float,
        yaw_rad: float,
    ) -> None:  # fmt: skip
        """Add one instant: the pose of the camera.

        `leg` differs in every leg, such as `MissionRun.retargets`. `known_xy_m` are the (n, 2)
        places of its target by the robot's map.
        """
        if leg != self._leg:
            self._leg, self._is_place_known = leg, False
            self._floor.begin_leg()
        _, again_m2 = self._floor.add_view(x_m, y_m, yaw_rad)
        self._is_place_known = self._is_place_known or self._is_target_at(target, known_xy_m)
        if not self._is_place_known:
            self.revisited_m2 += again_m2

    def _is_target_at(self, target: str, known_xy_m: np.ndarray) -> bool:
        """Return True if an object with this name stands at one of the known places."""
        objects = objects_named(self._world, target)
        return any(o.distance_m(*xy) <= SAME_M for o in objects for xy in known_xy_m.tolist())


class SeenFloor:
    """Floor that a camera has shown, as a raster with cells of about `CELL_M`."""

    def __init__(self, plan: FloorPlan, hfov_rad: float, range_m: float) -> None:
        grid = plan.grid
        self._factor = max(1, round(CELL_M / grid.resolution_m))
        rows, cols = (math.ceil(n / self._factor) for n in grid.cells.shape)
        padded = np.zeros((rows * self._factor, cols * self._factor), np.uint8)
        padded[: grid.cells.shape[0], : grid.cells.shape[1]] = grid.cells
        blocks = padded.reshape(rows, self._factor, cols, self._factor)
        self._blocked = blocks.max(axis=(1, 3)).astype(np.bool_)
        self._seen = np.zeros((rows, cols), np.uint8)
        self._grid = grid
        self._cell_m = self._factor * grid.resolution_m
        self._hfov_rad, self._range_cells = hfov_rad, range_m / self._cell_m
        nothing = np.zeros((0, 0), np.bool_), np.zeros((0, 0), np.uint8)
        mark_view(*nothing, 0.0, 0.0, 0.0, 1.0, 1.0)  # compile now, not in a timed tick

    def begin_leg(self) -> None:
        """Begin a leg: all floor that is seen now counts as seen before."""
        self._seen[self._seen != NEW] = BEFORE

    def add_view(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        """Add a view, and return the area that is new and the area that is revisited [m²].

        New floor was never seen. Revisited floor was seen before `begin_leg`, and now for the first
        time since.
        """
        col, row = self._grid.to_cells((x_m, y_m)) / self._factor
        new, again = mark_view(
            self._blocked, self._seen, col, row, yaw_rad, 0.5 * self._hfov_rad, self._range_cells
        )
        return new * self._cell_m**2, again * self._cell_m**2


@jit
def mark_view(blocked, seen, x, y, yaw_rad, half_rad, reach):
    """Mark the cells in view. Return how many are new, and how many were seen before but not since.

    `blocked` is (h, w) bool: such a cell stops a ray and is not floor. `seen`, (h, w) uint8, is
    changed in place. The camera's place and `reach`, its range, are in cells. `half_rad` is half
    the field of view.
    """
    h, w = blocked.shape
    rays = int(2 * half_rad * reach) + 2  # at most a cell apart at the end of the range
    new = again = 0
    for k in range(rays):
        angle = yaw_rad - half_rad + 2 * half_rad * k / (rays - 1)
        dx, dy = 0.5 * math.cos(angle), 0.5 * math.sin(angle)  # steps of half a cell
        for i in range(int(2 * reach)):
            col, row = math.floor(x + i * dx), math.floor(y + i * dy)
            if not (0 <= row < h and 0 <= col < w) or blocked[row, col]:
                break
            state = seen[row, col]
            if state & NOW:
                continue
            if state & BEFORE:
                again += 1
            else:
                new += 1
            seen[row, col] = state | NOW
    return new, again
