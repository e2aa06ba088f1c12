"""The probabilistic executor: the effect of an attempt, and the end of a run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.planning.delexicalised import delexicalise
from edge.lab.eval.planning.executor import (
    COMPLETE,
    DONE,
    GAVE_UP,
    MAX_DECISIONS,
    NOTHING,
    VIOLATED,
    EpisodeResult,
    PlanningProblem,
    draws_of,
    run_episode,
)
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse

LUCKY, UNLUCKY = 0.0, 0.999


def problem_of(text: str, others: int | None = None) -> PlanningProblem:
    formula = parse(text)
    others = delexicalise(formula).others if others is None else others
    return PlanningProblem.of(compile_formula(formula), others)


def luck(*rows: tuple[float, float]) -> np.ndarray:
    """Draws that begin with (luck, meeting) rows and go on lucky."""
    draws = np.zeros((MAX_DECISIONS, 3))
    draws[: len(rows), :2] = np.reshape(rows, (-1, 2))
    return draws


def say(*targets: int):
    """Return a planner that gives these answers in turn and records its inputs."""
    todo, asked = list(targets), []

    def choose(situation):
        asked.append(situation)
        return todo.pop(0) if todo else DONE

    choose.asked = asked
    return choose


def test_problem_puts_other_objects_behind_the_formulas():
    problem = problem_of("F (chair & F bed)")
    assert (problem.n_propositions, problem.n_objects) == (2, 6)
    assert problem.moves.shape == (3, 7)
    for other in range(2, 7):
        np.testing.assert_array_equal(problem.moves[:, other], [0, 1, 2])


@pytest.mark.parametrize(
    ("formula", "targets", "draws", "expected"),
    [
        ("true", [], luck(), EpisodeResult(COMPLETE, 0, 0)),
        ("F bed", [], luck(), EpisodeResult(GAVE_UP, 0, 0)),
        ("F bed", [0], luck(), EpisodeResult(COMPLETE, 1, 1)),
        ("F bed", [0, 0], luck((UNLUCKY, 0.0)), EpisodeResult(COMPLETE, 2, 2)),
        ("F sofa & G !bed", [1, 0], luck(), EpisodeResult(VIOLATED, 1, 1)),
        # The failed attempt on a shows b (the first object not known): it is reached directly.
        ("F a & F b", [0, 1, 0], luck((UNLUCKY, 0.0)), EpisodeResult(COMPLETE, 2, 3)),
        # A reached object stays known: a second visit is no exploration.
        ("F (a & F (b & F a))", [0, 1, 0], luck(), EpisodeResult(COMPLETE, 2, 3)),
        # An object that the formula does not name is nothing to the automaton.
        ("F bed", [3, 0], luck(), EpisodeResult(COMPLETE, 2, 2)),
        ("X bed", [NOTHING, 0], luck(), EpisodeResult(COMPLETE, 1, 1)),
        ("X bed", [3, 0], luck(), EpisodeResult(COMPLETE, 2, 2)),
        ("F bed & !bed", [0], luck(), EpisodeResult(VIOLATED, 1, 1)),
    ],
)
def test_run(formula, targets, draws, expected):
    assert run_episode(problem_of(formula), 0.5, say(*targets), draws) == expected


def test_success_on_the_last_decision_counts():
    problem, decisions = problem_of("F a", others=0), iter(range(MAX_DECISIONS))
    last = MAX_DECISIONS - 1
    episode = run_episode(problem, 1.0, lambda s: 0 if next(decisions) == last else NOTHING, luck())
    assert episode == EpisodeResult(COMPLETE, 1, 1)


def test_draws_depend_on_exactly_their_keys():
    base = draws_of(0, 5, 0.3, 0)
    np.testing.assert_array_equal(base, draws_of(0, 5, 0.3, 0))
    assert base.shape == (MAX_DECISIONS, 3)
    for other in (draws_of(1, 5, 0.3, 0), draws_of(0, 6, 0.3, 0), draws_of(0, 5, 0.4, 0)):
        assert not np.array_equal(base, other)
    assert not np.array_equal(base, draws_of(0, 5, 0.3, 1))
    assert base.min() >= 0
    assert base.max() < 1


@given(st.integers(0, 1000), st.sampled_from([0.1, 0.5, 1.0]), st.integers(1, 6))
def test_explorations_and_steps_have_lower_bounds(task, p_obs, k):
    """Any order of k objects: each is explored for once at least, or was met while exploring."""
    problem = problem_of(" & ".join(f"F x{i}" for i in range(k)), others=6 - k)

    def choose(situation):
        return next(i for i in range(k) if not situation.reached >> i & 1)

    episode = run_episode(problem, p_obs, choose, draws_of(0, task, p_obs, 0))
    assert episode.outcome == COMPLETE
    assert 1 <= episode.explorations <= episode.steps
    assert episode.steps >= k
    if p_obs == 1.0:
        assert episode.explorations == episode.steps == k
