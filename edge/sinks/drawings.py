"""Map drawings for people: the driven path, detected objects and the goal."""

from __future__ import annotations

import math

import numpy as np

from edge.bus.wire import markers
from edge.bus.wire.markers import Marker
from edge.geometry import SE2
from edge.types import Goal, Instance

_FRONTIER: markers.RGBA = (0.2, 0.6, 1.0, 0.8)
_THING: markers.RGBA = (1.0, 0.6, 0.1, 0.6)
_REFUTED: markers.RGBA = (0.5, 0.5, 0.5, 0.3)
_GOAL: markers.RGBA = (0.2, 0.9, 0.3, 0.9)
_WORDS: markers.RGBA = (1.0, 1.0, 1.0, 1.0)


class PathRing:
    """The driven path: the last poses, `apart_m` apart, in a preallocated ring."""

    def __init__(self, capacity: int = 2000, apart_m: float = 0.1) -> None:
        self._poses = np.zeros((capacity, 3))
        self._apart_m = apart_m
        self._n = 0

    def add(self, pose: SE2) -> None:
        if self._n:
            last = self._poses[(self._n - 1) % len(self._poses)]
            if math.hypot(pose.x_m - last[0], pose.y_m - last[1]) < self._apart_m:
                return
        self._poses[self._n % len(self._poses)] = pose.x_m, pose.y_m, pose.yaw_rad
        self._n += 1

    def poses(self) -> np.ndarray:
        """Return a copy of the poses, (n, 3) x, y, yaw, oldest first."""
        first = self._n % len(self._poses)
        if self._n <= len(self._poses):
            return self._poses[: self._n].copy()
        return np.roll(self._poses, -first, axis=0)


def markers_of(
    frontiers_m: np.ndarray, instances: list[Instance], goal: Goal | None
) -> list[Marker]:
    """Return markers: frontiers as spheres, objects as cubes with names, the goal as an arrow."""
    drawn = []
    if len(frontiers_m):
        points = np.zeros((len(frontiers_m), 3))
        points[:, :2] = frontiers_m
        drawn.append(
            Marker("frontiers", 0, markers.SPHERE_LIST, (0.1,) * 3, _FRONTIER, points_m=points)
        )
    for i, thing in enumerate(instances):
        x, y, z = map(float, thing.center_m)
        colour = _REFUTED if thing.state == "refuted" else _THING
        at, words = SE2(x, y, 0.0), f"{thing.label} {thing.score:.2f}"
        drawn.append(Marker("things", i, markers.CUBE, (0.25,) * 3, colour, at, z))
        drawn.append(Marker("names", i, markers.TEXT, (0.0, 0.0, 0.2), _WORDS, at, z + 0.4, words))
    if goal is not None:
        drawn.append(Marker("goal", 0, markers.ARROW, (0.5, 0.08, 0.08), _GOAL, goal.pose, 0.1))
    return drawn
