"""The planners that `edge eval planning` compares, behind one interface.

A planner is made in two calls: for a problem, then for p_obs, the probability that an exploration
finds its target. The result is called with a `PlannerInput` and returns the index of the next
target, or `NOTHING` (let a step pass) or `DONE` (stop). Only `optimal` uses p_obs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from edge.config import PlannerInOrder, PlannerVitl
from edge.lab.eval.planning.executor import (
    DONE,
    NOTHING,
    ChooseTarget,
    PlannerInput,
    PlanningProblem,
)
from edge.lab.eval.planning.optimum import Optimum
from edge.mission.planning.planner import MissionKnowledge, Planner, make_planner

MakeForProblem = Callable[[PlanningProblem], Callable[[float], ChooseTarget]]
"""Returns, for a problem, the function that makes the planner for a p_obs."""


class PlannerEntry(NamedTuple):
    """A planner of the comparison.

    Attributes:
        words: description for the table's legend.
        knows_all_places: True if the planner knows all places at the start.
    """

    make: MakeForProblem
    words: str
    knows_all_places: bool = False


def vitl(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return the service's `vitl` planner."""
    choose = _cached_chooser(make_planner(PlannerVitl(), problem.automaton), problem)
    return lambda p_obs: choose


def in_order(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return the service's `in_order` planner: the sentence's first object that makes progress."""
    choose = _cached_chooser(make_planner(PlannerInOrder(), problem.automaton), problem)
    return lambda p_obs: choose


def random_valid(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return a planner that draws any object that changes the state and keeps success possible."""
    targets = valid_targets(problem)

    def choose(known: PlannerInput) -> int:
        valid = targets[known.state]
        return valid[int(known.draw * len(valid))] if valid else DONE

    return lambda p_obs: choose


def clairvoyant(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return a planner that follows a shortest accepted trace: a lower bound on steps.

    The bound holds only if every place is known.
    """
    left = problem.steps_left
    left_after = left[problem.moves]  # (state, target): steps left after reaching the target
    # By state: the first target that leaves one step less.
    shortest = [
        next((i for i in range(problem.n_propositions) if left_after[s, i] == left[s] - 1), NOTHING)
        for s in range(len(left))
    ]
    return lambda p_obs: lambda known: shortest[known.state]


def least_explorations(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return the planner with the fewest expected explorations that any can have; see `Optimum`.

    Like all but `clairvoyant`, it knows only the places that were seen so far.
    """
    return lambda p_obs: Optimum(problem, p_obs).choose


PLANNERS = {
    "vitl": PlannerEntry(vitl, "ViTL eq. 1 and 2, reached objects known, as in the service"),
    "in-order": PlannerEntry(in_order, "first object of the sentence that makes valid progress"),
    "random-valid": PlannerEntry(random_valid, "any object that makes valid progress"),
    "optimal": PlannerEntry(least_explorations, "fewest expected explorations, the exact optimum"),
    "clairvoyant": PlannerEntry(
        clairvoyant, "knows every place: the bound for steps", knows_all_places=True
    ),
}


def valid_targets(problem: PlanningProblem) -> list[list[int]]:
    """Return, by state, the targets that change it and keep success possible, in formula order.

    `NOTHING` (let a step pass) is included only if no object does.
    """
    moves, alive = problem.moves, problem.steps_left >= 0
    # (state, target): the target leads to another state, from which success is possible.
    useful = alive[moves] & (moves != np.arange(len(moves))[:, None])
    targets = []
    for row in useful:
        objects = np.flatnonzero(row[: problem.n_propositions]).tolist()
        targets.append(objects or ([NOTHING] if row[-1] else []))  # last column: nothing reached
    return targets


def _cached_chooser(planner: Planner, problem: PlanningProblem) -> ChooseTarget:
    """Return a planner of the service as a `ChooseTarget` with a cache of its answers."""
    names = problem.automaton.propositions
    index = {name: i for i, name in enumerate(names)}
    named_bits = (1 << problem.n_propositions) - 1  # of the objects that the formula names
    answers: dict[tuple[int, int, int, int], int] = {}

    def choose(known: PlannerInput) -> int:
        state, current = known.state, known.current
        seen, reached = known.seen & named_bits, known.reached & named_bits
        key = (state, seen, reached, current)
        if key not in answers:
            detected = _names_of_bits(seen & ~reached, names)
            knowledge = MissionKnowledge(detected, _names_of_bits(reached, names), frozenset())
            plan = planner.plan(state, knowledge, names[current] if current >= 0 else None)
            # A plan with steps but without a target: the planner lets a step pass.
            waits = plan.feasible and bool(plan.steps)
            answers[key] = index.get(plan.target, NOTHING if waits else DONE)
        return answers[key]

    return choose


def _names_of_bits(mask: int, names: tuple[str, ...]) -> frozenset[str]:
    """Return the names of the propositions whose bits are set."""
    return frozenset(name for i, name in enumerate(names) if mask >> i & 1)
