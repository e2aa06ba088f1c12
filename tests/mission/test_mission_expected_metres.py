"""The planner of least expected metres against policy iteration on the model written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_plan_twins import HERE, MetreSearch, automata, compiled, knowing

from edge.config import PlannerExpected
from edge.mission.planner import Knowledge, PlannerError, make_planner
from edge.mission.planning.belief import SIGHT_M

BOTH, EITHER = "F a & F b", "F(a | b)"


def surveyed(knowledge: Knowledge, distance_m, search_m) -> Knowledge:
    """With metres: (k + 1, k), and (k + 1, k), whatever the target of the search is."""
    distance_m, search_m = np.array(distance_m, float), np.array(search_m, float)
    k = distance_m.shape[1]
    each = np.repeat(search_m[:, None], k, axis=1)
    return replace(knowledge, distance_m=distance_m, search_m=each)


def planned(text, knowledge=None, current=None, **config):
    planner = make_planner(PlannerExpected(**config), compiled(text))
    return planner.plan(0, knowledge or Knowledge(), current)


@pytest.mark.parametrize(
    ("text", "feasible", "cost"), [("true", True, 0.0), ("F a & G !a", False, math.inf)]
)
def test_nothing_to_plan(text, feasible, cost):
    plan = planned(text)
    assert (plan.target, plan.steps, plan.feasible, plan.cost) == (None, (), feasible, cost)


def test_without_a_survey_all_is_as_far():
    plan = planned("F a", explore_m=8.0)
    assert plan.cost == pytest.approx(8.0 + SIGHT_M)
    assert planned(BOTH, current="b", explore_m=8.0).target == "b"


@pytest.mark.parametrize(
    ("text", "failed", "blocked_by", "target"),
    [("F a", "a", ("a",), None), (EITHER, "a", (), "b"), (BOTH, "b", ("b",), None)],
)
def test_failed_objects(text, failed, blocked_by, target):
    plan = planned(text, knowing(failed=failed))
    assert (plan.target, plan.blocked_by) == (target, blocked_by)
    assert plan.feasible == (target is not None)


@pytest.mark.parametrize(
    ("a_m", "b_m", "current", "target"),
    [
        (5.0, 9.0, None, "a"),
        (9.0, 5.0, None, "b"),
        (5.5, 5.0, "a", "a"),  # less than the margin
        (6.5, 5.0, "a", "b"),
        (5.0, 5.0, "b", "b"),
    ],
)
def test_of_known_objects_the_nearer_is_gone_to(a_m, b_m, current, target):
    known = surveyed(knowing("ab"), [[0, 4], [4, 0], [a_m, b_m]], np.full((3, 2), 10.0))
    plan = planned(EITHER, known, current)
    assert plan.target == target
    assert dict(plan.options) == pytest.approx({"a": a_m, "b": b_m})


@pytest.mark.parametrize(
    ("a_m", "search_m", "target"), [(5.0, 10.0, "a"), (15.0, 10.0, "b"), (15.0, 14.0, "a")]
)
def test_a_search_that_is_short_beats_a_long_way(a_m, search_m, target):
    known = surveyed(knowing("a"), [[0, 9], [9, 2], [a_m, 9]], np.full((3, 2), search_m))
    assert planned(EITHER, known).target == target


@pytest.mark.parametrize(
    ("a_m", "b_m", "current", "target"),
    [
        (10.5, 10.0, "b", "b"),
        (9.5, 10.0, "b", "b"),  # it is known as well, and the margin is a metre
        (15.0, None, "a", "a"),  # b has to be found, in 10 m and 2: too little is saved for that
        (18.0, None, "a", "b"),
        (11.5, None, "b", "a"),  # what is known is certain
    ],
)
def test_a_margin_for_each(a_m, b_m, current, target):
    metres = [[0, 9], [9, 2 if b_m is None else 0], [a_m, b_m or 9]]
    known = knowing("a" if b_m is None else "ab")
    told = surveyed(known, metres, np.full((3, 2), 10.0))
    assert planned(EITHER, told, current).target == target


def test_what_was_seen_after_the_survey_is_near():
    """It lacks the distance to a; b was known then."""
    told = surveyed(knowing("ab"), [[2, 9], [9, 0], [14.0, 5.0]], np.full((3, 2), 10.0))
    assert dict(planned(EITHER, told).options) == pytest.approx({"a": SIGHT_M, "b": 5.0})


@pytest.mark.parametrize(("from_a_m", "target"), [(3.0, "a"), (25.0, "b")])
def test_where_a_search_goes_on_decides_what_comes_first(from_a_m, target):
    """Object a is 10 m off, b behind a frontier: one near a, or one here."""
    here_m, apart_m = 28.0 - from_a_m, from_a_m
    metres = [[0, apart_m], [apart_m, 2], [10.0, here_m]]
    known = surveyed(knowing("a"), metres, [[99, from_a_m], [99, 10], [99, here_m]])
    assert planned(BOTH, known).target == target


def test_objects_are_searched_for_together():
    """The first of two waits of 10 m takes 5; near it, then the other one from there."""
    known = surveyed(Knowledge(), np.full((3, 2), 6.0), np.full((3, 2), 10.0))
    assert planned(BOTH, known).cost == pytest.approx(5 + SIGHT_M + 10 + SIGHT_M)
    assert planned(EITHER, known).cost == pytest.approx(5 + SIGHT_M)


def test_that_is_searched_for_whose_frontiers_show_the_others_sooner():
    """Looking for b leads past where a may be, not the other way round."""
    search_m = np.zeros((3, 2, 2))
    search_m[:, 0], search_m[:, 1] = [10.0, 30.0], [12.0, 12.0]
    known = Knowledge(distance_m=np.full((3, 2), 10.0), search_m=search_m)
    assert planned(BOTH, known).target == "b"


def test_nothing_is_searched_for_that_would_not_bring_the_mission_on():
    """However soon the tv's search would show the chair."""
    text = "F(chair & F tv)"
    search_m = np.full((3, 2, 2), 50.0)
    search_m[:, compiled(text).letters.index("tv")] = 1.0
    known = Knowledge(distance_m=np.full((3, 2), 10.0), search_m=search_m)
    assert [letter for letter, _ in planned(text, known).options] == ["chair"]
    assert [letter for letter, _ in planned("(!b W a) & F b").options] == ["a"]


@pytest.mark.parametrize(
    ("a_m", "current", "why"),
    [
        (11.5, None, "a was seen: about 11.5 m to the end; b would have to be found: about 12.0 m"),
        (15, None, "b has to be found: about 12.0 m to the end; a was seen: about 15.0 m"),
        (11.5, "b", "a was seen: about 11.5 m to the end; b would have to be found: about 12.0 m"),
        (15, "a", "a is kept: b first would save about 3.0 m, not more than 5.0 m"),
    ],
)
def test_why_is_said_in_metres(a_m, current, why):
    known = surveyed(knowing("a"), [[0, 9], [9, 2], [a_m, 9]], np.full((3, 2), 10.0))
    assert planned(EITHER, known, current).reason == why


def test_distances_that_are_not_known_are_what_is_explored():
    known = surveyed(knowing("a"), np.full((3, 2), math.inf), np.full((3, 2), math.nan))
    assert planned("F a & (F b | true)", known).cost == pytest.approx(10.0)


@pytest.mark.parametrize("name", ["distance_m", "search_m"])
def test_metres_of_another_shape_are_refused(name):
    with pytest.raises(ValueError, match=f"{name}: expected shape"):
        planned("F a", replace(Knowledge(), **{name: np.zeros((3, 3))}))


@settings(max_examples=60, deadline=None)
@given(data=st.data(), automaton=automata(max_states=4, max_letters=3), seed=st.integers(0, 999))
def test_costs_are_those_of_policy_iteration(data, automaton, seed):
    letters, rng = automaton.letters, np.random.default_rng(seed)
    k = len(letters)
    drawn = st.sets(st.sampled_from(letters)) if letters else st.just(set())
    failed = data.draw(drawn)
    known = data.draw(drawn) - failed
    xy_m = rng.uniform(0, 10, (k + 1, 2))
    distance_m = np.hypot(*np.moveaxis(xy_m[:, None] - xy_m[:k], -1, 0))
    distance_m[np.arange(k), np.arange(k)] = 1.5
    search_m = rng.uniform(1, 20, (k + 1, k, k))
    places = (*letters, HERE)
    model = MetreSearch(
        automaton,
        {(p, x): distance_m[i, j] for i, p in enumerate(places) for j, x in enumerate(letters)},
        {
            (p, t, x): search_m[i, g, j]
            for i, p in enumerate(places)
            for g, t in enumerate(letters)
            for j, x in enumerate(letters)
        },
        known,
        failed,
    )
    optimum = model.optimum()
    planner = make_planner(PlannerExpected(), automaton)
    told = replace(knowing(known, failed=failed), distance_m=distance_m, search_m=search_m)
    for state in range(automaton.n_states):
        node = (state, frozenset(known), HERE)
        plan = planner.plan(state, told)
        best = 0.0 if automaton.accepting[state] else optimum.get(node, math.inf)
        assert plan.cost == pytest.approx(best, rel=1e-6, abs=1e-4)
        if not plan.feasible or automaton.accepting[state]:
            continue
        for letter, cost in plan.options:
            assert cost == pytest.approx(model.cost(node, letter, optimum), rel=1e-6, abs=1e-4)
        assert plan.options[0] == (plan.steps[0], plan.cost)
        for letter in plan.steps:
            assert letter not in failed
            state = automaton.step(state, letter)
        assert automaton.accepting[state]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (" & ".join(f"F a{i}" for i in range(8)), "8 objects and 256 states"),
        ("F(" + " | ".join(f"a{i}" for i in range(13)) + ")", "13 objects and 2 states"),
    ],
)
def test_a_table_that_would_be_too_large_is_refused(text, words):
    with pytest.raises(PlannerError, match=f"cannot take on .*{words}.*weights: constant"):
        make_planner(PlannerExpected(), compiled(text))
