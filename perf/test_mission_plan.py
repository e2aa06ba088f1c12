"""Benchmark: replanning of a mission, and driving distances between objects."""

from __future__ import annotations

import numpy as np
import pytest

from edge.config import PlannerVitl
from edge.geometry import Grid
from edge.loop.warmup import warm_planner
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse
from edge.mission.planning.distances import distances
from edge.mission.planning.planner import MissionKnowledge, make_planner

DISTANCE = PlannerVitl(weights="distance")


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_planner("distance")


def unordered(k: int):
    """Return the automaton of k objects in any order; it has 2^k states."""
    return compile_formula(parse(" & ".join(f"F object{i}" for i in range(k))))


def half_known(automaton) -> MissionKnowledge:
    """Return knowledge in which every second object is detected, with random distances."""
    propositions = automaton.propositions
    k = len(propositions)
    metres = np.random.default_rng(0).uniform(1.0, 20.0, (k + 1, k))
    return MissionKnowledge(frozenset(propositions[::2]), frozenset(), frozenset(), metres)


@pytest.mark.parametrize(
    ("name", "config", "k"),
    [
        ("replan_64", PlannerVitl(), 6),
        ("replan_distance_64", DISTANCE, 6),
        ("replan_4096", PlannerVitl(), 12),
        ("replan_distance_4096", DISTANCE, 12),
    ],
)
def test_replan(benchmark, name, config, k):
    benchmark.extra_info["budget"] = name
    automaton = unordered(k)
    assert automaton.n_states == 1 << k
    planner, knowledge = make_planner(config, automaton), half_known(automaton)
    plan = benchmark(planner.plan, 0, knowledge, automaton.propositions[-1])
    assert plan.feasible
    assert len(plan.steps) == k


def hall() -> tuple[Grid, list[np.ndarray]]:
    """Return a map of 50 m a side: a hall full of pillars, one fifth unknown, six objects."""
    rng = np.random.default_rng(0)
    cells = np.zeros((1000, 1000), np.int8)
    cells[800:] = -1
    for x, y in rng.integers(20, 980, (300, 2)):
        cells[y - 11 : y + 11, x - 11 : x + 11] = 99
        cells[y - 6 : y + 6, x - 6 : x + 6] = 100
    places = [rng.uniform(2.0, 48.0, (2, 2)) for _ in range(6)]
    return Grid(cells, (0.0, 0.0), 0.05), places


def test_distances_1000(benchmark):
    benchmark.extra_info["budget"] = "mission_distances_1000"
    snapshot, places = hall()
    out = benchmark(distances, snapshot, (25.0, 25.0), places)
    assert np.isfinite(out).all()
