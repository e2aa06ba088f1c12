"""Choice of one of the scored candidates as the goal: algorithm 2 of VL-Nav (III.E), without state.

An instance is a known object of the target's name. With any policy, instances come before
frontiers. The current goal stays unless another candidate is clearly better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from edge.geometry import SE2
from edge.policies.base import FRONTIER, INSTANCE, SNAP_M, SPIN, Candidates, PolicyInput
from edge.types import CandidateKind, Goal, Instance

# A frontier within this distance of a vanished one replaces it.
_SUCCESSOR_M = 1.0
STOP_M = (0.7, 0.85)
"""Stopping distances from the surface of an instance in metres, in order of preference. The second
one is for an object far back on a table, which the robot cannot get nearer to."""
_DETOUR = 1.3
"""The way to an object that is not mapped yet stays while it is at most this many times as long as
the shortest one. Straight lines go through walls, so the shortest one often changes."""
# The best cell may move by this distance, or by this share of the robot's distance to the cell,
# before the goal is replaced.
_MOVE_M, _MOVE_SHARE = 0.3, 0.25
_OBSERVE_M = (0.95, 1.2, 1.5)
"""Distances in metres from which the robot observes an instance while it knows no path to a nearer
stop. From there it may see such a path."""
ENOUGH_SHARE, MOST_POINTS = 0.2, 10
"""Number of surface points that must lie within the stopping distance: this share of all points,
but at most `MOST_POINTS`. Fewer points may belong to another object in front."""

_GOAL_KIND: dict[int, CandidateKind] = {FRONTIER: "frontier", INSTANCE: "instance", SPIN: "spin"}

_SECOND_VIEW_M, _MOST_AROUND_M = 0.6, 4.0
"""Distance of a stop from the only viewpoint that an instance was confirmed from, and the longest
path to such a stop. A larger distance would turn robots aside that drive straight to the object."""

Cell = tuple[float, float]


class InstanceQueries(NamedTuple):
    """Queries about instances, by id.

    Attributes:
        get: returns the instance, or None if it is gone.
        missed_from: returns True if the instance was out of reach from a place (x, y).
        only_viewpoint: returns the only place (x, y) that an instance was confirmed from. None: it
            has several, or a goal at it failed.
    """

    get: Callable[[int], Instance | None]
    missed_from: Callable[[int, Cell], bool]
    only_viewpoint: Callable[[int], Cell | None]


class CurrentGoal(NamedTuple):
    """The goal that the robot is driving to.

    Attributes:
        goal: the goal.
        peak: best score of the goal's candidate so far.
        often_left: returns True if the robot has often left this candidate before it arrived there.
    """

    goal: Goal
    peak: float
    often_left: Callable[[], bool]


def rank_candidates(
    candidates: Candidates,
    score: np.ndarray,
    pose: SE2,
    delta_reached_m: float,
    confirmed_first: bool = True,
) -> np.ndarray:
    """Return the indices of the candidates in the order of algorithm 2.

    Instances come first. Spins are ranked with the frontiers, by score. Blocked candidates and
    frontiers within `delta_reached_m` of the robot are left out.

    Args:
        candidates: the candidates.
        score: (n,) float32, their scores.
        pose: pose of the robot.
        delta_reached_m: see above.
        confirmed_first: True: confirmed instances come before other instances.

    Returns:
        (k,) int64.
    """
    n, kind = candidates.n, candidates.kind
    dx, dy = candidates.xy_m[:n, 0] - pose.x_m, candidates.xy_m[:n, 1] - pose.y_m
    # An instance is never too close: the mission verifies it at its position.
    far = (dx * dx + dy * dy > delta_reached_m**2) | (kind[:n] != FRONTIER)
    alive = np.flatnonzero(far & ~candidates.blocked[:n])
    doubtful = ~candidates.confirmed[alive] & confirmed_first
    # By the last key first: instances, confirmed ones, score, id.
    order = np.lexsort((candidates.id[alive], -score[alive], doubtful, kind[alive] != INSTANCE))
    return alive[order]


def choose(
    context: PolicyInput,
    score: np.ndarray,
    order: np.ndarray,
    held: CurrentGoal | None,
    margin: float,
    instances: InstanceQueries,
    stop_m: float = STOP_M[-1],
) -> tuple[Goal, float, bool] | None:
    """Return the best reachable candidate, or the current one if it is about as good.

    Args:
        context: the input of the policy.
        score: (n,) float32, of the context's candidates.
        order: result of `rank_candidates`.
        held: the current goal, if any.
        margin: how much better another candidate must be, as a fraction of the current score.
        instances: queries about the instances among the candidates.
        stop_m: stopping distance from an instance, tried before `STOP_M`; see `ENOUGH_SHARE`.

    Returns:
        A goal, the best score of its candidate so far, and True if the candidate is unchanged.
        The goal is a reachable free cell that faces the candidate; it is the same object as before
        while it is still valid. None if no candidate is reachable.
    """
    current = -1 if held is None else _index_of(held.goal, context.candidates)
    current_is_ranked = current in order
    for index in map(int, order):
        goal_m = None if held is None or index != current else held.goal.pose
        cell = _goal_cell(context, index, instances, stop_m, goal_m)
        if cell is None:
            continue
        if (
            held is not None
            and current_is_ranked
            and index != current
            and not _is_clearly_better(index, current, context, score, held, margin)
        ):
            kept = _goal_cell(context, current, instances, stop_m, held.goal.pose)
            if kept is not None:
                index, cell = current, kept
        value = float(score[index])
        if held is None or index != current:
            return _goal(context, index, cell, value), max(0.0, value), False
        goal = held.goal
        if not _is_still_valid(goal, cell, context):
            goal = _goal(context, index, cell, value)
        return goal, max(held.peak, value), True
    return None


def _is_clearly_better(
    index: int,
    current: int,
    context: PolicyInput,
    score: np.ndarray,
    held: CurrentGoal,
    margin: float,
) -> bool:
    """Return True if a better-ranked candidate is worth a change of goal.

    The robot completes its approach to an instance: the score of an instance falls when the robot
    is too near to see it whole. Without this rule, the robot would turn to another instance, and
    back. It also completes its approach to a frontier that it left often: the path there may lead
    past places where another frontier scores better.
    """
    kind, confirmed = context.candidates.kind, context.candidates.confirmed
    are_instances = kind[index] == INSTANCE, kind[current] == INSTANCE
    if are_instances[0] != are_instances[1] or confirmed[index] > confirmed[current]:
        return True
    if kind[current] == SPIN:
        return False
    if kind[index] == INSTANCE:
        return bool(score[index] > (1.0 + margin) * held.peak)
    return bool(score[index] > (1.0 + margin) * score[current]) and not held.often_left()


def _index_of(goal: Goal, candidates: Candidates) -> int:
    """Return the index of a goal's candidate, or of the frontier that replaced it; -1 if none."""
    if goal.kind == "spin":
        return candidates.n - 1 if candidates.kind[candidates.n - 1] == SPIN else -1
    if goal.kind == "instance":
        return candidates.index_of(INSTANCE, goal.candidate_id)
    index = candidates.index_of(FRONTIER, goal.candidate_id)
    return index if index >= 0 else candidates.nearest(FRONTIER, goal.candidate_xy_m, _SUCCESSOR_M)


def _is_still_valid(goal: Goal, cell: Cell, context: PolicyInput) -> bool:
    """Return True if a goal is still valid for its candidate, whose best cell is now `cell`.

    The tolerance grows with the distance, so a far goal is not resent for small changes.
    """
    if goal.kind == "spin":
        return context.candidates.index_of(SPIN, goal.candidate_id) >= 0
    free = context.map.state_at(goal.pose.x_m, goal.pose.y_m) == 0
    allowed_m = max(_MOVE_M, _MOVE_SHARE * context.pose.distance_to(*cell))
    return free and goal.pose.distance_to(*cell) < allowed_m


def _goal_cell(
    context: PolicyInput,
    index: int,
    instances: InstanceQueries,
    stop_m: float,
    held: SE2 | None,
) -> Cell | None:
    """Return the reachable free cell for a candidate; None if there is none.

    `held` is the current goal, if it is for this candidate.
    """
    candidates, pose = context.candidates, context.pose
    kind = int(candidates.kind[index])
    if kind == SPIN:
        return pose.x_m, pose.y_m
    if kind == INSTANCE:
        instance = instances.get(int(candidates.id[index]))
        if instance is None or instance.state == "rejected":  # changed since it was gathered
            return None
        return _instance_cell(context, instance, instances, stop_m, held)
    return _nearest_cell(context, candidates.xy_m[index], kind)


def _instance_cell(
    context: PolicyInput,
    instance: Instance,
    instances: InstanceQueries,
    stop_m: float,
    held: SE2 | None,
) -> Cell | None:
    """Return the reachable free cell for an instance; None if there is none.

    If no cell is near enough to stop there, the cell is one from which the instance is in sight and
    not far, or at the frontier on the shortest path to it, whichever path is shorter. Without both,
    it is next to the nearest point of the surface. If an instance was confirmed from one viewpoint
    only, the cell is away from there, if the path is short.
    """
    candidates, pose, points_m = context.candidates, context.pose, instance.points_m
    enough_points = max(1, min(MOST_POINTS, int(ENOUGH_SHARE * len(points_m))))
    # First near many points of its surface, then near any point, as `STOP_M` says.
    attempts = (stop_m, enough_points), *((fallback_m, 1) for fallback_m in STOP_M)
    only_view = instances.only_viewpoint(instance.id)
    if only_view is not None:
        disc = (*only_view, _SECOND_VIEW_M)
        found = context.map.stopping_point(points_m, stop_m, enough_points, disc)
        is_near = found is not None and found[2] <= _MOST_AROUND_M
        if found is not None and is_near and not instances.missed_from(instance.id, found[:2]):
            return found[:2]
    for within_m, points in attempts:
        found = context.map.stopping_point(points_m, within_m, points)
        if found is not None:
            return found[:2]
    away_m = np.hypot(points_m[:, 0] - pose.x_m, points_m[:, 1] - pose.y_m)
    xy_m = points_m[int(np.argmin(away_m)), :2]
    frontier, via_frontier_m = _frontier_towards(candidates, xy_m, held)
    for within_m in _OBSERVE_M:
        found = context.map.stopping_point(points_m, within_m)
        is_shorter = found is not None and found[2] + within_m <= via_frontier_m
        if found is not None and is_shorter and not instances.missed_from(instance.id, found[:2]):
            return found[:2]
    if frontier >= 0:
        return _nearest_cell(context, candidates.xy_m[frontier], FRONTIER)
    return _nearest_cell(context, xy_m, INSTANCE)


def _nearest_cell(context: PolicyInput, xy_m: np.ndarray, kind: int) -> Cell | None:
    """Return the reachable free cell nearest to a candidate of a kind, within `SNAP_M`."""
    found = context.map.nearest(float(xy_m[0]), float(xy_m[1]), float(SNAP_M[kind]))
    return None if found is None else found[:2]


def _frontier_towards(
    candidates: Candidates, xy_m: np.ndarray, held: SE2 | None
) -> tuple[int, float]:
    """Return the index of the frontier on the shortest path to an unmapped position; -1 if none.

    The frontier of the goal `held` stays while the path over it is not much longer. The second
    value is the length of the path over the frontier; inf without one.
    """
    n = candidates.n
    rest_m = np.hypot(candidates.xy_m[:n, 0] - xy_m[0], candidates.xy_m[:n, 1] - xy_m[1])
    total_m = candidates.path_m[:n] + rest_m
    total_m[(candidates.kind[:n] != FRONTIER) | candidates.blocked[:n]] = np.inf
    best = int(total_m.argmin()) if n else -1
    if held is not None:
        kept = candidates.nearest(FRONTIER, (held.x_m, held.y_m), _SUCCESSOR_M)
        if kept >= 0 and total_m[kept] <= _DETOUR * total_m[best]:
            best = kept
    if best < 0 or not np.isfinite(total_m[best]):
        return -1, math.inf
    return best, float(total_m[best])


def _goal(context: PolicyInput, index: int, cell: Cell, score: float) -> Goal:
    candidates = context.candidates
    x, y = map(float, candidates.xy_m[index])
    pose = SE2(cell[0], cell[1], math.atan2(y - cell[1], x - cell[0]))
    kind = _GOAL_KIND[int(candidates.kind[index])]
    candidate_id = int(candidates.id[index])
    return Goal(context.now_ns, pose, kind, candidate_id, (x, y), score, context.target)
