"""What no search can do better: policies that go by the simulator's truth.

Evaluations hand them the `world` that they ask for; a robot whose configuration names one is
refused at the start. They turn on the spot (`policy.look_round`) wherever that shows anything: it
costs no way, and the way is what SPL counts.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from edge.config import PolicySearch
from edge.lab.eval import geodesic
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.witness import SAME_M, named
from edge.lab.sim.base import Room, World, WorldObject
from edge.policies.base import INSTANCE, LOOK, Candidates, Context, Why
from edge.policies.search import Search

FAR_M = 1e3
"""The way where there is none."""
ELSEWHERE = 1e-6
"""Scores outside the target's rooms are so much smaller than within: they only lead there."""


class KnownPlace:
    """Goes to the nearest target the shortest way, as if its place were known.

    Of each frontier it counts the way there, by the map, and on from there, by the floor plan. What
    it then lacks is the controller's, the detector's and the stop's.

    Args:
        world: where the robot is.
    """

    def __init__(self, world: World, robot_radius_m: float) -> None:
        self._world, self._radius_m = world, robot_radius_m
        self._left_m: dict[str, np.ndarray] = {}

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        candidates, target = context.candidates, context.target
        if target not in self._left_m:
            self._left_m[target] = self._to_go_m(target)
        way_m = _path_m(candidates) + _at(self._world, self._left_m[target], candidates)
        way_m[candidates.kind[: candidates.n] == LOOK] = 0.0  # to turn is no way
        return _instances_first(self._world, context, 1.0 / (1.0 + way_m))

    def reset(self, why: Why) -> None:
        """It remembers nothing."""

    def _to_go_m(self, target: str) -> np.ndarray:
        """(rows, columns) float64 on the plan's raster: to where a target is near, and in the same
        room."""
        plan, near = self._world.plan, None
        for thing in named(self._world, target):
            close = geodesic.near(plan, [thing], self._radius_m, REACHED_M)
            room = room_of(self._world, thing)
            if room is not None:
                close &= inside(self._world, [room])
            near = close if near is None else near | close
        return everywhere(self._world, near, self._radius_m)


class KnownRoom:
    """Goes the shortest way to a room that holds a target, and searches there as `search` does.

    Args:
        world: where the robot is.

    Raises:
        ValueError: nobody knows the world's rooms.
    """

    def __init__(self, world: World, robot_radius_m: float) -> None:
        if not world.rooms:
            raise ValueError(f"{world.name}: nobody knows its rooms")
        self._world, self._radius_m = world, robot_radius_m
        self._search = Search(PolicySearch())
        self._left_m: dict[str, np.ndarray] = {}

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        candidates, target = context.candidates, context.target
        if target not in self._left_m:
            self._left_m[target] = self._to_go_m(target)
        left_m = _at(self._world, self._left_m[target], candidates)
        leads = ELSEWHERE / (1.0 + _path_m(candidates) + left_m)
        kind = candidates.kind[: candidates.n]
        leads[kind == LOOK] = ELSEWHERE  # to turn is no way
        score = np.where(left_m == 0.0, self._search.score(replace(context, prior=None)), leads)
        return _instances_first(self._world, context, score)

    def reset(self, why: Why) -> None:
        """It remembers nothing."""

    def _to_go_m(self, target: str) -> np.ndarray:
        """(rows, columns) float64 on the plan's raster: to the nearest room with a target."""
        held = {room_of(self._world, thing) for thing in named(self._world, target)} - {None}
        free = self._world.plan.clearance_m > self._radius_m
        return everywhere(self._world, inside(self._world, sorted(held)) & free, self._radius_m)


def everywhere(world: World, goal: np.ndarray | None, robot_radius_m: float) -> np.ndarray:
    """Metres to drive to the nearest goal, also of places where no robot fits, such as beside a
    wall: there it is as far as from the nearest where one does.

    Args:
        goal: (rows, columns) bool; None: there is none.

    Returns:
        (rows, columns) float64; `FAR_M` everywhere where no way leads there.
    """
    plan = world.plan
    free = plan.clearance_m > robot_radius_m
    cells = np.full(free.shape, np.inf)
    if goal is not None:
        cells[goal] = 0.0
    while geodesic.sweep(free, cells):
        pass
    known = np.isfinite(cells)
    if not known.any():
        return np.full(free.shape, FAR_M)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(nearest.max() + 1)
    of_label[nearest[known]] = cells[known]
    return of_label[nearest] * plan.grid.resolution_m


def room_of(world: World, thing: WorldObject) -> Room | None:
    """The room that a thing stands in, or is nearest to; None where nobody knows the rooms."""
    x, y = thing.center_m[:2]
    return min(world.rooms, key=lambda room: _away_m(room, x, y), default=None)


def _away_m(room: Room, x_m: float, y_m: float) -> float:
    return min(
        np.hypot(max(x0 - x_m, 0.0, x_m - x1), max(y0 - y_m, 0.0, y_m - y1))
        for x0, y0, x1, y1 in room
    )


def inside(world: World, rooms: list[Room]) -> np.ndarray:
    """(rows, columns) bool on the plan's raster: whether a place is in one of the rooms."""
    grid = world.plan.grid
    found = np.zeros(grid.cells.shape, bool)
    for x0, y0, x1, y1 in (rectangle for room in rooms for rectangle in room):
        (left, bottom), (right, top) = grid.of_metres((x0, y0)), grid.of_metres((x1, y1))
        rows = slice(max(round(bottom), 0), max(round(top), 0))
        found[rows, max(round(left), 0) : max(round(right), 0)] = True
    return found


def _path_m(candidates: Candidates) -> np.ndarray:
    path_m = candidates.path_m[: candidates.n].astype(np.float64)
    return np.where(np.isfinite(path_m), path_m, FAR_M)


def _at(world: World, left_m: np.ndarray, candidates: Candidates) -> np.ndarray:
    """(n,) float64, of a field at the candidates; off the plan: at its edge."""
    cells = world.plan.grid.of_metres(candidates.xy_m[: candidates.n].astype(np.float64))
    col, row = np.floor(cells).astype(int).T
    return left_m[np.clip(row, 0, len(left_m) - 1), np.clip(col, 0, left_m.shape[1] - 1)]


def _instances_first(world: World, context: Context, score: np.ndarray) -> np.ndarray:
    """With scores of instances: the nearer by path the better, and none for what is no target."""
    candidates, path_m = context.candidates, _path_m(context.candidates)
    things = named(world, context.target)
    for k in np.flatnonzero(candidates.kind[: candidates.n] == INSTANCE).tolist():
        x, y = candidates.xy_m[k].tolist()
        right = any(thing.distance_m(x, y) <= SAME_M for thing in things)
        score[k] = right / (1.0 + path_m[k])
    return score
