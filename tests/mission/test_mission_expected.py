"""The planner of least expected attempts against policy iteration on the model written out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_plan_twins import (
    CASE_1,
    CASE_2,
    CHOICE,
    Exploration,
    Search,
    automata,
    compiled,
    knowing,
)

from edge.config import PlannerExpected, PlannerVitl
from edge.mission.planner import Knowledge, PlannerError, make_planner
from edge.mission.planning import expected
from edge.perception.prior import table

FORMULAS = ["F a", CHOICE, CASE_1, CASE_2, "F a & F b & F c", "F a & F b & G !c"]


def constant(**config) -> PlannerExpected:
    return PlannerExpected(weights="constant", **config)


def planned(text, knowledge=None, current=None, extra=None, **config):
    """With `extra`, for the paper's executor; else for the robot."""
    planner = make_planner(constant(**config), compiled(text), universe_extra=extra)
    return planner.plan(0, knowledge or Knowledge(), current)


@pytest.mark.parametrize(
    ("text", "feasible", "cost"), [("true", True, 0.0), ("F a & G !a", False, math.inf)]
)
def test_nothing_to_plan(text, feasible, cost):
    plan = planned(text)
    assert (plan.target, plan.steps, plan.feasible, plan.cost) == (None, (), feasible, cost)


@pytest.mark.parametrize(
    ("current", "target"), [(None, "a"), ("b", "b"), ("c", "c"), ("elsewhere", "a")]
)
def test_ties(current, target):
    plan = planned("F a & F b & F c", current=current)
    assert plan.target == target
    assert plan.options[0][0] == target


@pytest.mark.parametrize(
    ("text", "failed", "blocked_by", "target"),
    [("F a", "a", ("a",), None), ("F(a | b)", "a", (), "b"), ("F a & F b", "b", ("b",), None)],
)
def test_failed_objects(text, failed, blocked_by, target):
    plan = planned(text, knowing(failed=failed))
    assert (plan.target, plan.blocked_by) == (target, blocked_by)
    assert plan.feasible == (target is not None)


@pytest.mark.parametrize("extra", [None, 0])
def test_a_failed_object_is_not_met_either(extra):
    """With b gone, exploring for a meets nothing."""
    assert planned("F a | F b", knowing(failed="b"), extra=extra).cost == pytest.approx(2.0)


# --- the robot: every look searches for everything ---


@pytest.mark.parametrize("p_obs", [1.0, 0.5, 0.1])
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_objects_are_searched_for_together(p_obs, count):
    """The longest of `count` independent waits of 1 / p; all but the last are gone to besides, or
    found as the target: of k unknown ones that is one in k."""
    waits = sum(1 / k for k in range(1, count + 1)) / p_obs
    walks = sum(1 - 1 / k for k in range(1, count + 1)) * 0.01
    text = " & ".join(f"F a{i}" for i in range(count))
    assert planned(text, p_obs=p_obs).cost == pytest.approx(waits + walks)


def test_a_known_object_is_gone_to():
    assert planned("F a & F b", knowing("b"), p_obs=0.5).cost == pytest.approx(0.01 + 2)


@pytest.mark.parametrize("p_obs", [1.0, 0.5, 0.1, 0.01])
def test_nothing_is_searched_for_merely_to_meet_another(p_obs):
    """What comes later is of no use now, however rare sights are."""
    for text in (CHOICE, "F(chair & F tv)", "F chair & (F tv | true)"):
        plan = planned(text, p_obs=p_obs)
        assert plan.target == "chair"
        assert dict(plan.options)["tv"] > plan.cost


def test_in_the_executor_looking_for_another_thing_can_be_better_luck():
    """At p_obs = 0.1 the tv's attempt, which serves nothing else, shows the chair 9 times of 10."""
    assert planned("F chair & (F tv | true)", p_obs=0.1, extra=0).target == "tv"


@settings(max_examples=60)
@given(
    data=st.data(),
    automaton=automata(max_states=5, max_letters=4),
    p_obs=st.sampled_from([0.05, 0.35, 1.0]),
)
def test_the_target_of_a_search_is_what_to_go_to_when_it_is_seen(data, automaton, p_obs):
    """No other target would bring any object nearer, so none is better by more than the step to
    an object that is seen and of use at once."""
    w_det = 0.25
    planner = make_planner(constant(p_obs=p_obs, w_det=w_det), automaton)
    letters = automaton.letters
    known = data.draw(st.sets(st.sampled_from(letters))) if letters else set()
    for state in range(automaton.n_states):
        plan = planner.plan(state, knowing(known))
        unknown = [x for x in letters if x not in known]
        searches = {x: cost for x, cost in plan.options if x in unknown}
        rate = p_obs * len(unknown)

        def gain(x, state=state):
            seen = knowing(known | {x})
            there = planner.plan(automaton.step(state, x), seen).cost
            return max(0.0, planner.plan(state, seen).cost - there)

        gains = {x: gain(x) for x in searches}
        for x in searches:
            assert gains[x] <= w_det + 1e-9
            for y in searches:
                less = (gains[x] - gains[y]) * p_obs / rate
                assert searches[y] - searches[x] == pytest.approx(less, abs=1e-6)
        if plan.target in searches:
            assert gains[plan.target] == pytest.approx(max(gains.values()), abs=1e-6)


def test_an_object_that_would_end_the_mission_is_no_target():
    plan = planned("(!b W a) & F b", p_obs=0.1)
    assert [letter for letter, _ in plan.options] == ["a"]


# --- the paper's executor ---


@pytest.mark.parametrize(
    ("p_obs", "extra", "cost"),
    [
        (1.0, 0, 1.0),
        (0.5, 0, 2.0),  # nothing else to meet: 1 / p
        (0.25, 0, 4.0),
        (0.5, 1, 2.0),
        (0.5, 3, 2.0),
    ],
)
def test_one_object_takes_one_over_p_attempts(p_obs, extra, cost):
    """Whatever else is met, since the objective is the only thing of use."""
    assert planned("F a", p_obs=p_obs, extra=extra).cost == pytest.approx(cost)


def test_two_objects_by_hand():
    """Explore for one: found (0.5), or the other one is seen and costs w_det to go to; then one
    is left, which takes two attempts."""
    plan = planned("F a & F b", p_obs=0.5, w_det=0.01, extra=0)
    assert plan.cost == pytest.approx(1 + 0.5 * 2 + 0.5 * (0.01 + 2))
    assert plan.steps == ("a", "b")


def test_an_extra_object_takes_chances_away():
    """Beside a and b there is one more to be met: known as soon as it was."""
    first = 1 + 0.5 * 2 + 0.5 * (0.5 * (0.01 + 2) + 0.5 * (1 + 0.5 * 2 + 0.5 * (0.01 + 2)))
    assert planned("F a & F b", extra=1).cost == pytest.approx(first)
    met = planned("F a & F b", knowing(["spoon"]), extra=1)
    assert met.cost == planned("F a & F b", extra=0).cost


def test_exploring_for_what_comes_later_can_be_best():
    """The tv is needed on every way, the chair only on one of two."""
    plan = planned(CHOICE, p_obs=0.5, extra=0)
    assert plan.steps == ("tv", "chair", "tv")
    assert plan.cost < dict(plan.options)["chair"]
    assert plan.reason == (
        "tv has to be found: about 2.51 attempts to the end; "
        "chair would have to be found: about 2.76 attempts"
    )


@pytest.mark.parametrize("text", FORMULAS)
def test_certain_exploration_gives_the_shortest_word(text):
    automaton = compiled(text)
    plan = planned(text, p_obs=1.0, extra=0)
    vitl = make_planner(PlannerVitl(), automaton).plan(0, Knowledge())
    assert len(plan.steps) == automaton.steps_left[0]
    assert plan.cost == pytest.approx(vitl.cost)
    assert plan.steps == vitl.steps


def test_where_finding_is_rare_it_pays_to_look_for_something_else():
    """At p_obs = 0.1 an object is met by chance sooner than found on purpose."""
    plan = planned(CHOICE, p_obs=0.1, extra=0)
    assert plan.cost == pytest.approx(2.568, abs=1e-3)
    assert vitl_value(compiled(CHOICE), 0.1, Exploration) == pytest.approx(6.963, abs=1e-3)


# --- both ---


@settings(max_examples=60)
@given(
    data=st.data(),
    automaton=automata(max_states=5, max_letters=3),
    p_obs=st.sampled_from([0.1, 0.35, 0.8, 1.0]),
    extra=st.none() | st.integers(0, 2),
)
def test_costs_are_those_of_policy_iteration(data, automaton, p_obs, extra):
    letters = automaton.letters
    failed = data.draw(st.sets(st.sampled_from(letters))) if letters else set()
    make = Search if extra is None else Exploration
    model = make(automaton, p_obs, 0.25, extra or 0, failed)
    optimum = model.optimum()
    config = constant(p_obs=p_obs, w_det=0.25)
    planner = make_planner(config, automaton, universe_extra=extra)
    for node in model.nodes:
        state, known, left = node
        met = [f"other {i}" for i in range((extra or 0) - left)]
        plan = planner.plan(state, knowing([*known, *met], failed=failed))
        best = 0.0 if automaton.accepting[state] else optimum.get(node, math.inf)
        assert plan.cost == pytest.approx(best, rel=1e-6, abs=1e-6)
        if not plan.feasible or automaton.accepting[state]:
            continue
        for letter, cost in plan.options:
            others = len(model.letters) - len(known) - 1 + left
            # Where the executor has nothing else to meet, it goes on until the object is found.
            if letter in known or letter == "" or others > 0:
                ways = {letter, f"?{letter}"}.intersection(model.actions(node))
                least = min(model.cost(node, way, optimum) for way in ways)
                assert cost == pytest.approx(least, rel=1e-6)
        assert plan.options[0] == (plan.steps[0], plan.cost)
        for letter in plan.steps:
            assert letter not in failed
            state = automaton.step(state, letter)
        assert automaton.accepting[state]


def vitl_value(automaton, p_obs: float, make) -> float:
    """What ViTL's planner costs under the model, worked out exactly."""
    model = make(automaton, p_obs, 0.01)
    vitl = make_planner(PlannerVitl(), automaton)
    policy = {}
    for node in model.nodes:
        plan = vitl.plan(node[0], knowing(node[1]))
        if plan.steps:
            policy[node] = plan.steps[0]
    return model.evaluate(policy)[0, frozenset(), 0]


@pytest.mark.parametrize("p_obs", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("text", FORMULAS)
@pytest.mark.parametrize(("make", "extra"), [(Search, None), (Exploration, 0)])
def test_vitl_never_costs_less(text, p_obs, make, extra):
    best = planned(text, p_obs=p_obs, extra=extra).cost
    assert best <= vitl_value(compiled(text), p_obs, make) + 1e-9


@pytest.mark.parametrize(
    ("text", "extra", "words"),
    [
        (" & ".join(f"F a{i}" for i in range(9)), 20, "9 objects and 512 states"),
        ("F(" + " | ".join(f"a{i}" for i in range(13)) + ")", 0, "13 objects and 2 states"),
    ],
)
def test_a_table_that_would_be_too_large_is_refused(text, extra, words):
    with pytest.raises(PlannerError, match=f"'expected' cannot take on .*{words}.*kind: vitl"):
        make_planner(constant(), compiled(text), universe_extra=extra)


def test_tables_are_kept_for_two_sets_of_failed_objects(monkeypatch):
    solved = []
    solve = expected.ExpectedPlanner._solve
    monkeypatch.setattr(
        expected.ExpectedPlanner, "_solve",
        lambda self, failed: solved.append(failed) or solve(self, failed),
    )  # fmt: skip
    planner = make_planner(constant(), compiled("F(a | b | c)"))
    for failed in ["", "spoon", "a", "", "a", "ab", ""]:
        planner.plan(0, knowing(failed=[failed] if len(failed) > 2 else failed))
    assert solved == [frozenset(x) for x in ["", "a", "ab", ""]]


# --- the co-occurrence prior ---


@pytest.mark.parametrize("names", [(), ("zeppelin",), ("bed", "pillow"), ("sink", "bed", "toilet")])
def test_probabilities_follow_the_rooms_of_known_objects(names):
    config = constant(p_obs=0.3, prior="cooccurrence")
    p = expected.find_probabilities(config, names)
    lift = table.load().lift(names)
    assert p.shape == (1 << len(names), len(names))
    for known in range(1 << len(names)):
        others = [i for i in range(len(names)) if known >> i & 1]
        for c in range(len(names)):
            mean = sum(lift[c, i] for i in others) / len(others) if others else 1.0
            assert p[known, c] == pytest.approx(min(max(0.3 * mean, 0.03), 1.0))


def test_a_prior_sends_the_robot_where_its_kind_of_room_is_known():
    """Beside a toilet there is a sink rather than a bed."""
    known = knowing(reached=["toilet"])
    text = "F(bed | sink) & (F toilet | true)"
    assert planned(text, known).target == "bed"
    assert planned(text, known, prior="cooccurrence").target == "sink"


def test_a_prior_on_words_that_the_table_lacks_changes_nothing():
    plain = planned("F(zeppelin & F blimp)", p_obs=0.4)
    assert planned("F(zeppelin & F blimp)", p_obs=0.4, prior="cooccurrence") == plain


def test_a_prior_model_is_solved_exactly():
    """Value iteration with the prior's probabilities agrees."""
    automaton = compiled("F sink & F toilet & F bed")
    config = constant(p_obs=0.5, prior="cooccurrence")
    letters = automaton.letters
    p = expected.find_probabilities(config, letters)

    class Prior(Search):
        def rate(self, letter, known):
            known = sum(1 << i for i, x in enumerate(letters) if x in known)
            return p[known, letters.index(letter)]

    best = Prior(automaton, 0.5, 0.01).optimum()[0, frozenset(), 0]
    assert make_planner(config, automaton).plan(0, Knowledge()).cost == pytest.approx(best)
    assert not np.isclose(best, Search(automaton, 0.5, 0.01).optimum()[0, frozenset(), 0])
