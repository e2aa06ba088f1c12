"""Floor that a mission's searches see again, by ground truth.

A leg is one target pursued. While its place is not known the robot searches. Floor that a look
shows, but that an earlier leg had shown already, was searched again.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np
from numba import njit

from edge import names
from edge.config import Config
from edge.lab.sim.base import FloorPlan, World

PLACE_M = 0.1
SAME_M = 0.5  # a belief this near a thing is of that thing
NEW, BEFORE, NOW = 0, 1, 2
"""Of a place: never seen; seen before this leg; seen in it (bits)."""


class Legs:
    """Follows a mission from instant to instant.

    Args:
        range_m: how far the detector sees.

    Attributes:
        again_m2: floor seen while a target was searched for that earlier legs had seen.
    """

    def __init__(self, config: Config, world: World, range_m: float) -> None:
        camera = config.sensors.camera
        self.again_m2 = 0.0
        self._world = world
        self._floor = SeenFloor(world.plan, math.radians(camera.hfov_deg), range_m)
        self._turn: Hashable | None = None
        self._known = False

    def update(
        self, turn: Hashable, target: str, known_xy_m: np.ndarray, x_m: float, y_m: float,
        yaw_rad: float,
    ) -> None:  # fmt: skip
        """Take in an instant.

        Args:
            turn: another one in every leg, such as `MissionRun.turns`.
            known_xy_m: (n, 2) where the robot believes that such things stand.
            yaw_rad: where the camera looks.
        """
        if turn != self._turn:
            self._turn, self._known = turn, False
            self._floor.begin()
        _, again_m2 = self._floor.look(x_m, y_m, yaw_rad)
        self._known = self._known or self._is_there(target, known_xy_m)
        if not self._known:
            self.again_m2 += again_m2

    def _is_there(self, target: str, known_xy_m: np.ndarray) -> bool:
        """Return whether a thing of that name stands where the robot believes that one does."""
        things = [o for o in self._world.objects if names.same(o.label, target)]
        return any(o.distance_m(*xy) <= SAME_M for o in things for xy in known_xy_m.tolist())


class SeenFloor:
    """Floor that a camera has shown, as a raster of places of 0.1 m."""

    def __init__(self, plan: FloorPlan, hfov_rad: float, range_m: float) -> None:
        """
        Args:
            plan: what stands on it hides what is behind.
        """
        grid = plan.grid
        self._factor = max(1, round(PLACE_M / grid.resolution_m))
        rows, cols = (-(-n // self._factor) for n in grid.cells.shape)
        whole = np.zeros((rows * self._factor, cols * self._factor), np.uint8)
        whole[: grid.cells.shape[0], : grid.cells.shape[1]] = grid.cells
        blocks = whole.reshape(rows, self._factor, cols, self._factor)
        self._closed = blocks.max(axis=(1, 3)).astype(np.bool_)
        self._seen = np.zeros((rows, cols), np.uint8)
        self._grid = grid
        self._place_m = self._factor * grid.resolution_m
        self._hfov_rad, self._range = hfov_rad, range_m / self._place_m
        nothing = np.zeros((0, 0), np.bool_), np.zeros((0, 0), np.uint8)
        cast(*nothing, 0.0, 0.0, 0.0, 1.0, 1.0)  # compiled here, not while a tick is timed

    def begin(self) -> None:
        """From here on, what was seen until now counts as seen before."""
        self._seen[self._seen != NEW] = BEFORE

    def look(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        """m² that this look shows and none has shown before; and m² that were seen before `begin`
        and are seen again for the first time since."""
        col, row = self._grid.of_metres((x_m, y_m)) / self._factor
        new, again = cast(
            self._closed, self._seen, col, row, yaw_rad, 0.5 * self._hfov_rad, self._range
        )
        return new * self._place_m**2, again * self._place_m**2


@njit(nogil=True, cache=True)
def cast(closed, seen, x, y, yaw_rad, half_rad, reach):
    """Mark the places in view; counts those never seen, and those seen before but not since.

    Args:
        closed: (h, w) bool, what stops a ray; it is itself not floor.
        seen: (h, w) uint8, in place.
        x, y, reach: in places.
    """
    h, w = closed.shape
    rays = int(2 * half_rad * reach) + 2
    new = again = 0
    for k in range(rays):
        angle = yaw_rad - half_rad + 2 * half_rad * k / (rays - 1)
        dx, dy = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
        for i in range(int(2 * reach)):
            col, row = math.floor(x + i * dx), math.floor(y + i * dy)
            if not (0 <= row < h and 0 <= col < w) or closed[row, col]:
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
