"""Algorithm 2 of VL-Nav (III.E): from scored candidates to the one to go to. No state of its own.

Whatever the policy, instances come before frontiers, and what the robot is under way to stays
unless something else is clearly better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from edge.geometry import SE2
from edge.policies.base import FRONTIER, INSTANCE, LOOK, SNAP_M, Candidates, Context
from edge.types import CandidateKind, Goal, Instance

# A frontier that vanished while another stands this near was merely redrawn.
_HEIR_M = 1.0
STOP_M = (0.7, 0.85)
"""The robot stops as soon as it is so near to an instance; what stands far back on a table it may
not get nearer to."""
# A goal's cell may move so far, or by this share of the way there, before it is chosen anew.
_MOVE_M, _MOVE_SHARE = 0.3, 0.25
ENOUGH, MOST_POINTS = 0.2, 10
"""So many points of its surface, as a share and at most, are to be so near: a few may be another
thing's, that stands before it."""

_GOAL_KIND: dict[int, CandidateKind] = {FRONTIER: "frontier", INSTANCE: "instance", LOOK: "look"}

Cell = tuple[float, float]
InstanceOf = Callable[[int], Instance | None]


class Held(NamedTuple):
    """What the robot is under way to.

    Attributes:
        peak: the best score of the goal's candidate so far.
        fickle: whether the robot has often left this place for another, before it came there.
    """

    goal: Goal
    peak: float
    fickle: Callable[[], bool]


def ranked(
    candidates: Candidates, score: np.ndarray, pose: SE2, delta_reached_m: float
) -> np.ndarray:
    """Indices of the candidates in the order algorithm 2 would take them.

    Instances come before all frontiers, confirmed ones first, each by score; frontiers within
    `delta_reached_m` of the robot, and discarded candidates, are left out.

    Returns:
        (k,) int64.
    """
    n, kind = candidates.n, candidates.kind
    dx, dy = candidates.xy_m[:n, 0] - pose.x_m, candidates.xy_m[:n, 1] - pose.y_m
    # An instance is never "too close": the mission verifies it on the spot instead.
    far = (dx * dx + dy * dy > delta_reached_m**2) | (kind[:n] != FRONTIER)
    alive = np.flatnonzero(far & ~candidates.blocked[:n])
    order = np.lexsort(
        (candidates.id[alive], -score[alive], ~candidates.sure[alive], kind[alive] != INSTANCE)
    )
    return alive[order]


def choose(
    context: Context,
    score: np.ndarray,
    order: np.ndarray,
    held: Held | None,
    margin: float,
    instance_of: InstanceOf,
) -> tuple[Goal, float, bool] | None:
    """The best candidate that can be reached, or the present one where that is about as good.

    Args:
        score: (n,) float32, of the context's candidates.
        order: as from `ranked`.
        margin: how much better another must be, as a fraction of the present one's score.
        instance_of: the instance of an id; None where there is none any more.

    Returns:
        A goal on a free cell that the robot can reach, facing its candidate, the same object as
        before while that serves; the best score of its candidate so far; and whether that is the
        candidate from before.
    """
    present = -1 if held is None else _index_of(held.goal, context.candidates)
    may_stay = present in order
    for index in map(int, order):
        cell = _cell(context, index, instance_of)
        if cell is None:
            continue
        if (
            held is not None
            and may_stay
            and index != present
            and not _beats(index, present, context, score, held, margin)
        ):
            kept = _cell(context, present, instance_of)
            index, cell = (index, cell) if kept is None else (present, kept)
        value = float(score[index])
        if held is None or index != present:
            return _goal(context, index, cell, value), max(0.0, value), False
        goal = held.goal
        if not _serves(goal, cell, context):
            goal = _goal(context, index, cell, value)
        return goal, max(held.peak, value), True
    return None


def _beats(
    index: int, present: int, context: Context, score: np.ndarray, held: Held, margin: float
) -> bool:
    """Whether a better-ranked candidate is worth a change of goal.

    An instance is seen through: its score falls while the robot comes too near to see it whole,
    and must not make it turn to another, whose score then falls, and back. So is a frontier that
    was left often: the way to it may lead past where the other scores better.
    """
    kind, sure = context.candidates.kind, context.candidates.sure
    instances = kind[index] == INSTANCE, kind[present] == INSTANCE
    if instances[0] != instances[1] or sure[index] != sure[present]:
        return True
    if kind[present] == LOOK:
        return False
    if kind[index] == INSTANCE:
        return bool(score[index] > (1.0 + margin) * held.peak)
    return bool(score[index] > (1.0 + margin) * score[present]) and not held.fickle()


def _index_of(goal: Goal, candidates: Candidates) -> int:
    """A goal's candidate: by identity, or a frontier that took its place; -1: it has none."""
    if goal.kind == "look":
        return candidates.n - 1 if candidates.kind[candidates.n - 1] == LOOK else -1
    if goal.kind == "instance":
        return candidates.index_of(INSTANCE, goal.candidate_id)
    same = candidates.index_of(FRONTIER, goal.candidate_id)
    return same if same >= 0 else candidates.nearest(FRONTIER, goal.candidate_xy_m, _HEIR_M)


def _serves(goal: Goal, cell: Cell, context: Context) -> bool:
    """Whether a goal still serves its candidate, whose best cell is `cell` now.

    A cell far ahead may move farther before the controller need hear of it.
    """
    if goal.kind == "look":
        return context.candidates.index_of(LOOK, goal.candidate_id) >= 0
    free = context.map.state_at(goal.pose.x_m, goal.pose.y_m) == 0
    allowed_m = max(_MOVE_M, _MOVE_SHARE * context.pose.distance_to(*cell))
    return free and goal.pose.distance_to(*cell) < allowed_m


def _cell(context: Context, index: int, instance_of: InstanceOf) -> Cell | None:
    """The reachable free cell to stand on for a candidate."""
    candidates, pose = context.candidates, context.pose
    kind, xy_m = int(candidates.kind[index]), candidates.xy_m[index]
    if kind == LOOK:
        return pose.x_m, pose.y_m
    if kind == INSTANCE:
        instance = instance_of(int(candidates.id[index]))
        if instance is None or instance.state == "refuted":  # since they were gathered
            return None
        enough = max(1, min(MOST_POINTS, int(ENOUGH * len(instance.points_m))))
        for points in (enough, 1):
            for within_m in STOP_M:
                found = context.map.approach(instance.points_m, within_m, points)
                if found is not None:
                    return found[0], found[1]
        surface_m = instance.points_m[:, :2]
        away = np.hypot(surface_m[:, 0] - pose.x_m, surface_m[:, 1] - pose.y_m)
        xy_m = surface_m[int(np.argmin(away))]
        through = _way_through(candidates, xy_m)
        if through >= 0:
            xy_m, kind = candidates.xy_m[through], FRONTIER
    found = context.map.nearest(float(xy_m[0]), float(xy_m[1]), float(SNAP_M[kind]))
    return None if found is None else (found[0], found[1])


def _way_through(candidates: Candidates, xy_m: np.ndarray) -> int:
    """The frontier through which the way to a place that is not known yet is the shortest; -1."""
    n = candidates.n
    there = np.hypot(candidates.xy_m[:n, 0] - xy_m[0], candidates.xy_m[:n, 1] - xy_m[1])
    way = candidates.path_m[:n] + there
    way[(candidates.kind[:n] != FRONTIER) | candidates.blocked[:n]] = np.inf
    best = int(way.argmin()) if n else -1
    return best if best >= 0 and np.isfinite(way[best]) else -1


def _goal(context: Context, index: int, cell: Cell, score: float) -> Goal:
    candidates = context.candidates
    x, y = map(float, candidates.xy_m[index])
    pose = SE2(cell[0], cell[1], math.atan2(y - cell[1], x - cell[0]))
    kind = _GOAL_KIND[int(candidates.kind[index])]
    candidate_id = int(candidates.id[index])
    return Goal(context.now_ns, pose, kind, candidate_id, (x, y), score, context.target)
