"""The baseline planner: order of mention, within what the mission allows."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mission_plan_twins import CASE_1, CHOICE, automata, compiled, knowing, knowledge_of

from edge.config import PlannerInOrder, PlannerVitl
from edge.mission.planning.planner import make_planner


def planned(text, knowledge=None, state=0):
    return make_planner(PlannerInOrder(), compiled(text)).plan(state, knowledge or knowing())


@pytest.mark.parametrize(
    ("text", "feasible", "cost"), [("true", True, 0.0), ("F a & G !a", False, math.inf)]
)
def test_nothing_to_plan(text, feasible, cost):
    plan = planned(text)
    assert (plan.target, plan.steps, plan.feasible, plan.cost) == (None, (), feasible, cost)


@pytest.mark.parametrize(
    ("text", "knowledge", "steps"),
    [
        ("F b & F a", None, ("b", "a")),
        ("F b & F a", knowing("a"), ("b", "a")),  # detected objects change nothing
        (CHOICE, knowing(["couch", "tv"]), ("chair", "tv")),
        (CHOICE, knowing(failed=["chair"]), ("couch", "tv")),
        ("F (a & F b) & !a W c", None, ("c", "a", "b")),  # the constraint comes first
        (CASE_1, None, ("bed", "plant", "tv")),  # a target that may only come later is skipped
    ],
)
def test_targets_are_planned_in_the_order_of_mention(text, knowledge, steps):
    plan = planned(text, knowledge)
    assert plan.steps == steps
    assert plan.target == steps[0]
    assert "first in the sentence" in plan.reason


@given(data=st.data(), automaton=automata())
def test_a_plan_is_found_if_there_is_one(data, automaton):
    knowledge = data.draw(knowledge_of(automaton.propositions))
    mine = make_planner(PlannerInOrder(), automaton)
    vitl = make_planner(PlannerVitl(), automaton)
    for state in range(automaton.n_states):
        plan, other = mine.plan(state, knowledge), vitl.plan(state, knowledge)
        assert plan.feasible == other.feasible
        if plan.steps:
            assert not set(plan.steps) & knowledge.failed
            after = automaton.step(state, plan.steps[0])
            assert after != state
            assert vitl.plan(after, knowledge).feasible
