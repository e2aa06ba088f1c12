"""Oracle policies for evaluations: upper bounds that use the simulator's ground truth.

An evaluation passes them the simulator's `world`. A robot refuses a configuration that names one.
They spin (`policy.spin`) if a spin shows anything: SPL (success weighted by path length) counts
only the path, and a spin adds none.

A distance field has the metres left to drive from each cell, (rows, columns) float64.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from edge.config import PolicySearch
from edge.lab.eval import geodesic
from edge.lab.eval.ground_truth import SAME_M, objects_meant_by
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.true_rooms import inside, room_of
from edge.lab.sim.base import World
from edge.policies.base import INSTANCE, SPIN, Candidates, PolicyInput, Why
from edge.policies.search import SearchPolicy

FAR_M = 1e3
"""Distance if there is no path."""
OUTSIDE_FACTOR = 1e-6
"""Factor on scores outside the target's rooms. They are then below all scores inside."""


class _KnownTarget:
    """A policy that knows, by target, the distance left to drive from each cell of the plan."""

    def __init__(self, world: World, robot_radius_m: float) -> None:
        self._world, self._radius_m = world, robot_radius_m
        self._left_m: dict[str, np.ndarray] = {}  # distance fields by target

    def _left_at(self, context: PolicyInput) -> np.ndarray:
        """Return the distance that is left from each candidate, (n,) float64."""
        target = context.target
        if target not in self._left_m:
            goal = self._goal_cells(target)
            self._left_m[target] = cost_to_goal_m(self._world, goal, self._radius_m)
        return _values_at(self._world, self._left_m[target], context.candidates)

    def _goal_cells(self, target: str) -> np.ndarray | None:
        """Return (rows, columns) bool: True where the distance is 0; None: nowhere."""
        raise NotImplementedError

    def reset(self, why: Why) -> None:
        """Do nothing: the policy has no state."""


class KnownPlace(_KnownTarget):
    """Policy that drives the shortest path to the nearest target, as if its place were known.

    The cost of a frontier is the path to it, by the map, plus the path from there to the target, by
    the floor plan. The SPL that is still missing is lost by the controller, the detector and the
    stop decision.
    """

    def score(self, context: PolicyInput) -> np.ndarray:
        candidates = context.candidates
        total_m = _path_m(candidates) + self._left_at(context)
        total_m[candidates.kind[: candidates.n] == SPIN] = 0.0  # a spin adds no path
        return _score_instances(self._world, context, 1.0 / (1.0 + total_m))

    def _goal_cells(self, target: str) -> np.ndarray | None:
        """Return the cells that are near a target and in its room."""
        plan, near = self._world.plan, None
        for item in objects_meant_by(self._world, target):
            close = geodesic.near(plan, [item], self._radius_m, REACHED_M)
            room = room_of(self._world, item)
            if room is not None:
                close &= inside(self._world, [room])
            near = close if near is None else near | close
        return near


class KnownRoom(_KnownTarget):
    """Policy that drives to a room with a target and searches there as `search` does.

    Raises:
        ValueError: the world has no room data.
    """

    def __init__(self, world: World, robot_radius_m: float) -> None:
        if not world.rooms:
            raise ValueError(
                f"{world.name}: the rooms of this world are not known, but KnownRoom needs them; "
                "use ProcTHOR houses"
            )
        super().__init__(world, robot_radius_m)
        self._search = SearchPolicy(PolicySearch())

    def score(self, context: PolicyInput) -> np.ndarray:
        candidates, left_m = context.candidates, self._left_at(context)
        outside_score = OUTSIDE_FACTOR / (1.0 + _path_m(candidates) + left_m)
        kind = candidates.kind[: candidates.n]
        outside_score[kind == SPIN] = OUTSIDE_FACTOR  # a spin adds no path
        score = np.where(
            left_m == 0.0, self._search.score(replace(context, prior=None)), outside_score
        )
        return _score_instances(self._world, context, score)

    def _goal_cells(self, target: str) -> np.ndarray:
        """Return the free cells of the rooms with a target."""
        targets = objects_meant_by(self._world, target)
        rooms = {room_of(self._world, item) for item in targets}
        target_rooms = sorted(room for room in rooms if room is not None)
        return inside(self._world, target_rooms) & (self._world.plan.clearance_m > self._radius_m)


def cost_to_goal_m(world: World, goal: np.ndarray | None, robot_radius_m: float) -> np.ndarray:
    """Return the driving distance [m] from every cell to the nearest goal cell.

    `goal` is (rows, columns) bool; None: there is no goal. Without a path to a goal, the distance
    is `FAR_M`. A cell where the robot does not fit, such as one next to a wall, gets the distance
    of the nearest cell where it does.
    """
    ends = np.zeros(world.plan.grid.cells.shape, bool) if goal is None else goal
    distance_m = geodesic.distance_to(world.plan, ends, robot_radius_m)
    known = np.isfinite(distance_m)
    if not known.any():
        return np.full(ends.shape, FAR_M)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    # `nearest` has the label of the nearest known cell; each known cell has a label of its own.
    distance_by_label = np.zeros(nearest.max() + 1)
    distance_by_label[nearest[known]] = distance_m[known]
    return distance_by_label[nearest]


def _path_m(candidates: Candidates) -> np.ndarray:
    """Return the path to each candidate, (n,) float64; `FAR_M` if there is none."""
    path_m = candidates.path_m[: candidates.n].astype(np.float64)
    return np.where(np.isfinite(path_m), path_m, FAR_M)


def _values_at(world: World, left_m: np.ndarray, candidates: Candidates) -> np.ndarray:
    """Return the field `left_m` at each candidate, (n,) float64; outside the plan, at its edge."""
    cells = world.plan.grid.to_cells(candidates.xy_m[: candidates.n].astype(np.float64))
    col, row = np.floor(cells).astype(int).T
    return left_m[np.clip(row, 0, len(left_m) - 1), np.clip(col, 0, left_m.shape[1] - 1)]


def _score_instances(world: World, context: PolicyInput, score: np.ndarray) -> np.ndarray:
    """Set the scores of instance candidates, in place: 1 / (1 + path) for a true target, else 0."""
    candidates, path_m = context.candidates, _path_m(context.candidates)
    objects = objects_meant_by(world, context.target)
    for k in np.flatnonzero(candidates.kind[: candidates.n] == INSTANCE).tolist():
        x, y = candidates.xy_m[k].tolist()
        right = any(item.distance_m(x, y) <= SAME_M for item in objects)
        score[k] = right / (1.0 + path_m[k])
    return score
