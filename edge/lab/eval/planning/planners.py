"""The planners that `edge eval planning` compares, behind one interface.

A planner is made for a problem, then for a p_obs, and then answers situations
(`edge.lab.eval.planning.executor.ChooseTarget`). Only `optimal` uses p_obs.
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
        make: makes the planner for a problem.
        words: description for the table's legend.
        knows_all_places: True if the planner knows all places at the start.
    """

    make: MakeForProblem
    words: str
    knows_all_places: bool = False


def vitl(problem: PlanningProblem, known_reached: bool = True) -> Callable[[float], ChooseTarget]:
    """Return the service's `vitl` planner; see `VitlPlanner` for `known_reached`."""
    planner = make_planner(PlannerVitl(), problem.automaton, known_reached=known_reached)
    choose = _cached_chooser(planner, problem)
    return lambda p_obs: choose


def vitl_eq1(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return ViTL eq. 1 to the letter: a reached object weighs 1, as if it had to be found."""
    return vitl(problem, known_reached=False)


def in_order(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return the service's `in_order` planner: the sentence's first object that makes progress."""
    choose = _cached_chooser(make_planner(PlannerInOrder(), problem.automaton), problem)
    return lambda p_obs: choose


def random_valid(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return a planner that draws any object that changes the state and keeps success possible."""
    targets = valid_targets(problem)

    def choose(situation: PlannerInput) -> int:
        valid = targets[situation.state]
        return valid[int(situation.draw * len(valid))] if valid else DONE

    return lambda p_obs: choose


def clairvoyant(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return a planner that follows a shortest accepted trace: a lower bound on steps.

    The bound holds only if every place is known.
    """
    left = problem.steps_left
    left_after = left[problem.moves]
    shortest = [
        next((i for i in range(problem.n_propositions) if left_after[s, i] == left[s] - 1), NOTHING)
        for s in range(len(left))
    ]
    return lambda p_obs: lambda situation: shortest[situation.state]


def least_explorations(problem: PlanningProblem) -> Callable[[float], ChooseTarget]:
    """Return the exact optimum for the planners' information; see `Optimum`."""
    return lambda p_obs: Optimum(problem, p_obs).choose


PLANNERS = {
    "vitl": PlannerEntry(vitl, "ViTL eq. 1 and 2, reached objects known, as in the service"),
    "vitl-eq1": PlannerEntry(vitl_eq1, "ViTL eq. 1 and 2 to the letter: reached objects weigh 1"),
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
    useful = alive[moves] & (moves != np.arange(len(moves))[:, None])
    targets = []
    for row in useful:
        letters = np.flatnonzero(row[: problem.n_propositions]).tolist()
        targets.append(letters or ([NOTHING] if row[-1] else []))  # last column: nothing reached
    return targets


def _cached_chooser(planner: Planner, problem: PlanningProblem) -> ChooseTarget:
    """Return a planner of the service as a `ChooseTarget` with a cache of its answers."""
    letters = problem.automaton.propositions
    index = {letter: i for i, letter in enumerate(letters)}
    named_bits = (1 << problem.n_propositions) - 1  # of the objects that the formula names
    answers: dict[tuple[int, int, int, int], int] = {}

    def choose(situation: PlannerInput) -> int:
        state, current = situation.state, situation.current
        seen, reached = situation.seen & named_bits, situation.reached & named_bits
        key = (state, seen, reached, current)
        if key not in answers:
            detected = _names(seen & ~reached, letters)
            knowledge = MissionKnowledge(detected, _names(reached, letters), frozenset())
            plan = planner.plan(state, knowledge, letters[current] if current >= 0 else None)
            waits = plan.feasible and bool(plan.steps)
            answers[key] = index.get(plan.target, NOTHING if waits else DONE)
        return answers[key]

    return choose


def _names(mask: int, letters: tuple[str, ...]) -> frozenset[str]:
    """Return the propositions of the bits that are set."""
    return frozenset(letter for i, letter in enumerate(letters) if mask >> i & 1)
