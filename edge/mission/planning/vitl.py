"""The planner of ViTL IV-A2: the shortest weighted path over the automaton."""

from __future__ import annotations

import math

import numpy as np

from edge.config import PlannerVitl
from edge.mission.logic.automaton import NOTHING, Automaton
from edge.mission.planning import plan_kernels as kernels
from edge.mission.planning.plan import (
    ACCEPTED,
    DEAD,
    MissionKnowledge,
    TargetPlan,
    explain,
    explain_blocked,
    explain_hysteresis,
)

W_DET = 0.01
"""Weight of a detected object."""
W_FAIL = 1000.0
"""Weight of a failed object in the reported costs."""
REPLAN_MARGIN_M = 1.0
"""With distances, the target changes only if another path is shorter by more than this."""
EXPLORE_M = 10.0
"""Assumed driving distance to an object that was not found yet."""
W_NOTHING = 1e-6
"""Weight of a step that reaches nothing: nearly free, but positive so that it is never wasted."""


class VitlPlanner:
    """Shortest-path planner (eq. 2) with constant weights (eq. 1) or driving distances.

    Constant weights: a proposition weighs `W_DET` if its object was detected, else 1. A failed one
    weighs more than any path without it. So a plan contains a failed edge only if every path does
    (the paper's "sum >= w_fail", for paths of any length). Weights are multiples of 1e-6.

    Distances: a known object weighs the metres from the object before it, an unknown one
    `EXPLORE_M`. The distance from the robot to an object is never more than by way of other
    objects. From an object at an unknown place, the distance to a known object is the hypotenuse of
    `EXPLORE_M` and its distance from the robot. The current target is kept unless another path is
    better by more than `REPLAN_MARGIN_M`. With constant weights the target changes at once.

    Steps that keep the state are never planned. The planner reuses its buffers: use it from one
    thread at a time.
    """

    def __init__(self, config: PlannerVitl, automaton: Automaton) -> None:
        self.automaton = automaton
        k, n = len(automaton.propositions), automaton.n_states
        self._by_distance = config.weights == "distance"
        # A place is one of the k objects, or the robot's position, which is the last one; see
        # `plan_kernels` for the arrays.
        places = k + 1 if self._by_distance else 1
        self._robot_place = places - 1
        self._order = order_of_relaxation(automaton)
        # A path without a failed edge enters no node twice, so it always costs less than FAILED.
        self._heaviest = int(kernels.FAILED - 1) // (n * places)
        self._weight = np.empty((k + 1, places), np.int64)
        self._cost = np.empty((n, places), np.int64)
        self._steps = np.empty((n, places), np.int32)
        self._first_cost = np.empty(k + 1, np.int64)
        self._first_steps = np.empty(k + 1, np.int32)
        self._path = np.empty(n * places + 1, np.int32)

    def plan(
        self, state: int, knowledge: MissionKnowledge, current: str | None = None
    ) -> TargetPlan:
        """Return the plan; see `Planner.plan`.

        Raises:
            ValueError: `distance_m` does not fit the number of propositions.
        """
        a = self.automaton
        if a.accepting[state]:
            return ACCEPTED
        if a.steps_left[state] < 0:
            return DEAD
        self._weigh(knowledge)
        kernels.cost_to_go(a.delta, a.accepting, self._order, self._weight, self._cost, self._steps)
        kernels.first_step_costs(
            a.delta, self._weight, self._cost, self._steps, state, self._robot_place,
            self._first_cost, self._first_steps,
        )  # fmt: skip
        cost, steps = self._first_cost.tolist(), self._first_steps.tolist()
        names = (*a.propositions, NOTHING)
        # Columns of `delta`, best first.
        ranked = sorted(
            (c for c in range(len(names)) if cost[c] != kernels.UNREACHABLE),
            key=lambda c: (cost[c], steps[c], names[c] != current),
        )
        options = tuple((names[c], self._as_weight(cost[c])) for c in ranked)
        first = best = ranked[0]
        if cost[best] >= kernels.FAILED:
            # Even the best path needs failed objects; it needs as few as possible.
            path = self._follow(best, state)
            needed = tuple(dict.fromkeys(name for name in path if name in knowledge.failed))
            reason = explain_blocked(needed)
            return TargetPlan(None, (), math.inf, False, needed, reason, options)
        if self._by_distance and names[best] != current:
            first = self._column_to_pursue(ranked, cost, current)
        path = self._follow(first, state)
        if first == best:
            reason = explain(path[0], options, knowledge, self._by_distance)
        else:
            gain_m = self._as_weight(cost[first] - cost[best])
            reason = explain_hysteresis(path[0], names[best], gain_m, REPLAN_MARGIN_M)
        return TargetPlan(
            path[0] or None, path, self._as_weight(cost[first]), True, (), reason, options
        )

    def _column_to_pursue(self, ranked: list[int], cost: list[int], current: str | None) -> int:
        """Return the current target's column if it is within the margin, else the best one."""
        limit = cost[ranked[0]] + round(REPLAN_MARGIN_M * kernels.SCALE)
        names = self.automaton.propositions
        if current in names:
            c = names.index(current)
            if c in ranked and cost[c] <= min(limit, int(kernels.FAILED) - 1):
                return c
        return ranked[0]

    def _follow(self, first: int, state: int) -> tuple[str, ...]:
        """Return the best trace that begins with column `first` of `delta`."""
        a = self.automaton
        length = kernels.follow(
            a.delta, a.accepting, self._weight, self._cost, self._steps, state, self._robot_place,
            first, self._path,
        )  # fmt: skip
        names = (*a.propositions, NOTHING)
        return tuple(names[c] for c in self._path[:length].tolist())

    def _as_weight(self, cost: int) -> float:
        """Return an integer cost as the sum of eq. 2, with `W_FAIL` for each failed edge."""
        failed, rest = divmod(cost, int(kernels.FAILED))
        return failed * W_FAIL + rest / kernels.SCALE

    def _weigh(self, knowledge: MissionKnowledge) -> None:
        """Write the weights (eq. 1, or metres) to `_weight`."""
        names, weight = self.automaton.propositions, self._weight
        # Unlike eq. 1, a reached object weighs as a detected one, because its place is known.
        known = knowledge.detected | knowledge.reached
        if self._by_distance:
            metres = _weights_m(knowledge.distance_m, [x in known for x in names])
            weight[:-1] = np.minimum(np.rint(metres.T * kernels.SCALE), self._heaviest)
        else:
            near, far = (min(max(round(w * kernels.SCALE), 1), self._heaviest)
                         for w in (W_DET, 1.0))  # fmt: skip
            weight[:-1, 0] = [near if x in known else far for x in names]
        for i, name in enumerate(names):
            if name in knowledge.failed:
                weight[i] = kernels.FAILED
        weight[-1] = round(W_NOTHING * kernels.SCALE)


def _weights_m(distance_m: np.ndarray | None, known: list[bool]) -> np.ndarray:
    """Return the weight in metres of each object from each place; see `VitlPlanner`.

    Args:
        distance_m: see `MissionKnowledge.distance_m`; None if no distance is known.
        known: True for each object that is known.

    Returns:
        (k + 1, k) float64.
    """
    k = len(known)
    metres = np.full((k + 1, k), EXPLORE_M)
    if distance_m is None:
        return metres
    if distance_m.shape != (k + 1, k):
        raise ValueError(f"distance_m: expected shape {(k + 1, k)}, got {distance_m.shape}")
    placed = np.array(known, bool) & np.isfinite(distance_m[-1])
    for j in np.flatnonzero(placed):
        from_robot = distance_m[-1, j]
        between = distance_m[:-1, j]
        metres[:-1, j] = np.where(
            placed & np.isfinite(between), between, math.hypot(EXPLORE_M, from_robot)
        )
        metres[-1, j] = from_robot
    metres = np.maximum(metres, 0.0)
    close_triangle_inequality(metres)
    return metres


def close_triangle_inequality(metres: np.ndarray) -> None:
    """Shorten distances from the robot to those by way of other objects, in place.

    Rounded distances, and distances between objects with several instances, can violate the
    triangle inequality. Then a return to the object just reached could seem better, again and
    again.
    """
    from_robot = metres[-1]
    for _ in range(len(from_robot)):
        by_way = (from_robot[:, None] + metres[:-1]).min(axis=0)
        if (by_way >= from_robot).all():
            return
        np.minimum(from_robot, by_way, out=from_robot)


def order_of_relaxation(automaton: Automaton) -> np.ndarray:
    """Return the states that are neither accepting nor dead, nearest to acceptance first.

    Returns:
        (m,) int32. Of equally near states, the later one comes first: states are numbered from the
        initial state, so later ones are mostly nearer to acceptance.
    """
    left = automaton.steps_left
    order = np.lexsort((-np.arange(left.size), left))
    return order[(left[order] >= 0) & ~automaton.accepting[order]].astype(np.int32)
