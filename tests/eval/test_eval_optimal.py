"""The optimal policy: against value iteration on the definition, against simulation, and against
what can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from edge.eval import optimal
from edge.eval.executor import COMPLETE, DONE, NOTHING, Problem, draws_of, run_episode
from edge.eval.lifted import lift
from edge.eval.task_planners import least_explorations
from edge.eval.task_templates import generate
from edge.mission.automaton import Automaton, compile_formula, steps_left
from edge.mission.logic.limits import Effort
from edge.mission.ltl import TRUE, parse


def problem_of(text: str, others: int = 0) -> Problem:
    return Problem.of(compile_formula(parse(text)), others)


def value_iteration(problem: Problem, p_obs: float, sweeps: int = 2000) -> np.ndarray:
    """Least expected explorations by sweeping over the executor's definition until it settles."""
    n_states, everything = len(problem.moves), (1 << problem.n_objects) - 1
    value = np.where(problem.accepting, 0.0, np.inf)[:, None].repeat(everything + 1, axis=1)
    value[(problem.steps_left >= 0) & ~problem.accepting] = 1e6
    for _ in range(sweeps):
        before = value.copy()
        for s in range(n_states):
            if problem.accepting[s] or problem.steps_left[s] < 0:
                continue
            for known in range(everything + 1):
                costs = [value[problem.moves[s, -1], known] + optimal.WAIT_COST]
                for i in range(problem.n_letters):
                    after = value[problem.moves[s, i], known | 1 << i]
                    if known >> i & 1:
                        costs.append(optimal.DIRECT_COST + after)
                        continue
                    others = [
                        value[s, known | 1 << o]
                        for o in range(problem.n_objects)
                        if o != i and not known >> o & 1
                    ]
                    missed = np.mean(others) if others else value[s, known]
                    missed = 0.0 if p_obs == 1.0 else (1.0 - p_obs) * missed
                    costs.append(1.0 + p_obs * after + missed)
                value[s, known] = min(costs)
        if np.allclose(before, value, rtol=0, atol=1e-12, equal_nan=True):
            return value
    raise AssertionError("did not settle")


FORMULAS = [
    "F a",
    "X a",
    "F (a & X F a)",
    "F a & F b & F c",
    "F ((a | b) & F c) & G !d",
    "(F (a & F b) | F (c & F a)) & (!c W b)",
    "F (a & F (b & F a))",
]


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize("p_obs", [0.1, 0.55, 1.0])
def test_kernel_equals_value_iteration(formula, p_obs):
    problem = problem_of(formula, others=1)
    value, action = optimal.solve(problem, p_obs)
    np.testing.assert_allclose(value, value_iteration(problem, p_obs), atol=1e-6)
    done = problem.accepting | (problem.steps_left < 0)
    assert (action[done] == DONE).all()
    assert (action[~done] != DONE).all()


@pytest.mark.parametrize("seed", range(12))
def test_kernel_equals_value_iteration_on_random_automata(seed):
    """Automata that no formula of the benchmark gives: cycles, dead ends, waiting."""
    rng = np.random.default_rng(seed)
    n_states, n_letters, others = rng.integers(2, 7), rng.integers(1, 4), rng.integers(0, 2)
    delta = rng.integers(0, n_states, (n_states, n_letters + 1)).astype(np.int32)
    accepting = rng.random(n_states) < 0.25
    left = steps_left(delta, accepting, Effort())
    letters = tuple("abc"[:n_letters])
    problem = Problem.of(Automaton(TRUE, letters, delta, accepting, left), int(others))
    p_obs = float(rng.uniform(0.1, 1.0))
    value, _ = optimal.solve(problem, p_obs)
    np.testing.assert_allclose(value, value_iteration(problem, p_obs), atol=1e-6)


@pytest.mark.parametrize(
    ("formula", "others", "p_obs", "expected"),
    [
        ("true", 0, 0.5, 0.0),
        ("F a & G !a", 3, 0.5, np.inf),
        ("F a", 0, 0.25, 4.0),  # 1 / p
        ("F (a & X F a)", 0, 0.5, 2.0),  # the second visit is free
        ("F a & F b & F c", 3, 1.0, 3.0),
        ("F a", 1, 0.5, 1 + 0.5 * 2.0),  # then the other one is known and a is all that is left
        ("F (a | b)", 0, 0.25, 1.0),  # whichever is found
    ],
)
def test_value_by_hand(formula, others, p_obs, expected):
    value, _ = optimal.solve(problem_of(formula, others), p_obs)
    assert value[0, 0] == pytest.approx(expected, abs=1e-5)


def test_waits_only_where_the_formula_asks_for_it():
    problem = problem_of("X a")
    _, action = optimal.solve(problem, 0.5)
    assert action[0, 0] == NOTHING
    after = problem.moves[0, -1]
    assert action[after, 0] == 0


def test_simulation_agrees_with_the_exact_value():
    """The executor and the solver are written apart; they must mean the same model."""
    tasks = generate(12, seed=3)
    p_obs, episodes = 0.4, 150
    for task in tasks:
        lifted = lift(task.formula)
        problem = Problem.of(lifted.automaton, lifted.others)
        choose = least_explorations(problem)(p_obs)
        runs = [
            run_episode(problem, p_obs, choose, draws_of(0, task.id, p_obs, e))
            for e in range(episodes)
        ]
        assert all(run.outcome == COMPLETE for run in runs)
        counts = np.array([run.explorations for run in runs])
        error = counts.std(ddof=1) / np.sqrt(episodes)
        exact = optimal.solve(problem, p_obs)[0][0, 0]
        assert abs(counts.mean() - exact) < 4.5 * error + 1e-3, task.sentence


def test_what_is_too_large_is_told_before():
    problem = problem_of("F a")
    assert optimal.solvable(problem)
    assert not optimal.solvable(problem_of("F a", others=25))
