"""The compared planners: the paper's case studies, 100 % completion, and the ranking."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from edge.lab.eval.planning.delexicalised import delexicalise, world_of
from edge.lab.eval.planning.executor import (
    COMPLETE,
    MAX_DECISIONS,
    NOTHING,
    PlanningProblem,
    draws_of,
    run_episode,
)
from edge.lab.eval.planning.optimum import Optimum
from edge.lab.eval.planning.planners import PLANNERS, valid_targets
from edge.lab.eval.planning.sweep import Settings, run_tasks
from edge.lab.eval.planning.templates import generate
from edge.mission.logic.ltl import parse, propositions

CASE_1 = parse(
    "(F(toilet & F bed) | F(couch & F chair) | F(plant & F tv)) "
    "& (!tv W bed) & (!toilet W couch) & (!couch W tv)"
)
CASE_2 = parse(
    "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet)) "
    "| F(tv & F(plant & F couch))) & (!couch W toilet) & (!bed W tv) & (!plant W chair)"
)


def problem_of(formula) -> PlanningProblem:
    lifted = delexicalise(formula)
    return PlanningProblem.of(lifted.automaton, lifted.others)


def way(formula, planner: str, p_obs: float = 1.0) -> tuple[str, ...]:
    """Return the planner's order of targets if every exploration finds its target."""
    problem, objects = problem_of(formula), world_of(propositions(formula))
    choose, reached = PLANNERS[planner].make(problem)(p_obs), []

    def noted(situation):
        target = choose(situation)
        reached.append(objects[target])
        return target

    episode = run_episode(problem, 1.0, noted, np.zeros((MAX_DECISIONS, 3)))
    assert episode.outcome == 0
    return tuple(reached)


@pytest.mark.parametrize("planner", ["vitl", "optimal", "clairvoyant"])
def test_case_studies_under_the_weak_until(planner):
    """ViTL tables II and III: the second plan is the only optimum, the first one of two."""
    assert way(CASE_2, planner) == ("tv", "bed", "toilet")
    assert way(CASE_1, planner) in {("bed", "plant", "tv"), ("plant", "bed", "tv")}


def test_optima_of_the_case_studies_agree_with_brute_force():
    def optima(formula):
        automaton = delexicalise(formula).automaton
        objects = propositions(formula)
        words = permutations(range(6), 3)
        found = [w for w in words if automaton.accepts([automaton.propositions[i] for i in w])]
        return {tuple(objects[i] for i in word) for word in found}

    assert optima(CASE_1) == {("bed", "plant", "tv"), ("plant", "bed", "tv")}
    assert optima(CASE_2) == {("tv", "bed", "toilet")}


@pytest.fixture(scope="module")
def results():
    settings = Settings(tuple(PLANNERS), (0.1, 0.5, 1.0), episodes=2)
    return run_tasks(generate(120), settings)


def test_everything_is_completed_given_right_formulas(results):
    assert results.complete.all()


def test_no_planner_beats_the_bounds(results):
    optimum = results.planners.index("optimal")
    clairvoyant = results.planners.index("clairvoyant")
    assert (results.steps >= results.bound[None, None, :, None]).all()
    assert (results.steps[clairvoyant] == results.bound[None, :, None]).all()
    assert (results.explorations[clairvoyant] == 0).all()
    searching = [k for k in range(len(results.planners)) if k != clairvoyant]
    # Without luck (p_obs = 1) the optimum is the optimum in every run.
    certain = results.explorations[searching, -1]
    assert (certain >= results.explorations[optimum, -1]).all()


def test_service_planners_lie_between_optimum_and_chance(results):
    mean = dict(zip(results.planners, results.explorations.mean(axis=(1, 2, 3)), strict=True))
    assert mean["optimal"] < mean["vitl"] < mean["in-order"]


def test_simulation_agrees_with_the_exact_value():
    """The executor and the solver are written apart; they must mean the same model."""
    p_obs, episodes = 0.4, 150
    for task in generate(12, seed=3):
        problem = problem_of(task.formula)
        optimum = Optimum(problem, p_obs)
        runs = [
            run_episode(problem, p_obs, optimum.choose, draws_of(0, task.id, p_obs, e))
            for e in range(episodes)
        ]
        assert all(run.outcome == COMPLETE for run in runs)
        counts = np.array([run.explorations for run in runs])
        error = counts.std(ddof=1) / np.sqrt(episodes)
        exact = optimum.value[0, problem.n_objects - problem.n_propositions, 0]
        assert abs(counts.mean() - exact) < 4.5 * error + 1e-3, task.sentence


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("F a", [[0], []]),
        ("F (a & F b)", [[0], [1], []]),
        ("F a & G !b", [[0], [], []]),
        ("!a & X a", [[NOTHING], [0], [], []]),
    ],
)
def test_valid_targets(formula, expected):
    targets = valid_targets(problem_of(parse(formula)))
    assert targets[0] == expected[0]
    assert sorted(targets) == sorted(expected)
