"""Benchmark: evaluation of one planner over 2000 tasks and ten p_obs, and parts of it."""

from __future__ import annotations

import pytest

from edge.lab.eval.planning.delexicalised import compiled, delexicalise
from edge.lab.eval.planning.executor import PlannerInput, PlanningProblem, draws_of, run_episode
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.sweep import Settings, run_tasks
from edge.lab.eval.planning.templates import generate
from edge.mission.logic.ltl import parse

P_OBS = tuple(i / 10 for i in range(1, 11))
SAMPLE = 200
CASE_2 = (
    "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet)) "
    "| F(tv & F(plant & F couch))) & (!couch W toilet) & (!bed W tv) & (!plant W chair)"
)


@pytest.fixture(scope="module")
def tasks():
    """Return the benchmark's first tasks of all families, with compiled kernels."""
    found = generate(SAMPLE)
    run_tasks(found[:1], Settings(tuple(PLANNERS), (0.5,)))
    return found


def test_tasks_sample(benchmark, tasks):
    """Measure a tenth of the tasks, with compiled automata and new plans in every round."""
    benchmark.extra_info["budget"] = f"eval_planning_{SAMPLE}_vitl"
    settings = Settings(("vitl",), P_OBS)
    results = benchmark.pedantic(run_tasks, args=(tasks, settings), rounds=5, warmup_rounds=1)
    assert results.complete.all()


def test_task_episode(benchmark):
    """Measure 64 runs of case study 2, for which the plans are already made."""
    benchmark.extra_info["budget"] = "eval_planning_episode"
    lifted = delexicalise(parse(CASE_2))
    problem = PlanningProblem.of(lifted.automaton, lifted.others)
    choose = PLANNERS["vitl"].make(problem)(0.5)
    draws = [draws_of(0, task, 0.5, 0) for task in range(64)]

    def run():
        return [run_episode(problem, 0.5, choose, draw) for draw in draws]

    run()
    episodes = benchmark(run)
    benchmark.extra_info["episodes"] = len(draws)
    assert all(episode.outcome == 0 for episode in episodes)


def test_optimal_policy(benchmark):
    """Measure the exact optimum of case study 2 at one p_obs: 32 states, 64 sets of objects."""
    benchmark.extra_info["budget"] = "eval_planning_optimum"
    problem = PlanningProblem.of(compiled(delexicalise(parse(CASE_2)).formula), 0)
    optimum = PLANNERS["optimal"].make(problem)
    optimum(0.5)(PlannerInput(0))
    assert benchmark(lambda: optimum(0.5)(PlannerInput(0))) >= 0


@pytest.mark.slow
def test_tasks_whole(benchmark):
    """Measure everything for one planner on one core: tasks, automata, plans, 20,000 runs."""
    benchmark.extra_info["budget"] = "eval_planning_2000_vitl"

    def plan_all():
        compiled.cache_clear()
        return run_tasks(generate(2000), Settings(("vitl",), P_OBS))

    assert benchmark.pedantic(plan_all, rounds=1).complete.all()
