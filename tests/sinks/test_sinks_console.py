"""What the progress line and the report say about the mission."""

from __future__ import annotations

import pytest
from simulated import simulated

from edge.cli.console import _ahead, story_of
from edge.mission.brief import prepare
from edge.mission.run import MissionRun

S = 1_000_000_000


def mission(formula: str) -> MissionRun:
    config = simulated().mission
    run = MissionRun(prepare(config, formula=formula), config)
    run.start(0)
    return run


@pytest.mark.parametrize(
    ("formula", "ahead"),
    [
        ("F chair", "chair"),
        ("F(chair & F sofa)", "chair (then sofa)"),
        ("F(chair & X F(sofa & X X F chair))", "chair (then sofa, nothing, chair)"),
    ],
)
def test_the_line_names_the_target_and_what_comes_after_it(formula, ahead):
    assert _ahead(mission(formula)) == ahead


def test_a_long_plan_is_cut():
    things = ("bed", "bench", "bottle", "bowl", "box", "candle", "chair", "clock", "cup", "desk")
    run = mission(" & ".join(f"F {thing}" for thing in things))
    assert len(_ahead(run)) < 80


def test_the_story_of_a_mission_under_way():
    run = mission("F(chair & F sofa) & (!bed W sofa)")
    run.arrive("seen in 9 images", S)
    story = story_of(run)
    assert (story.state, story.word, story.plan) == (run.state, ("chair",), ("sofa",))
    assert story.automaton.run(story.word) == story.state
    assert [step.label for step in story.reached] == ["chair"]
    assert [step.kind for step in story.steps] == ["start", "target", "reached", "target"]
    assert not story.simple


def test_the_story_of_a_mission_that_is_over():
    run = mission("F chair")
    run.arrive("seen in 9 images", S)
    story = story_of(run)
    assert (story.plan, story.simple) == ((), True)
    assert story.steps[-1].kind == "end"
    assert _ahead(run) == "chair"


def test_the_story_of_a_mission_that_failed_says_what_was_left():
    run = mission("F(chair & F sofa)")
    run.fail("time limit of 45 s", S)
    assert story_of(run).plan == ("chair", "sofa")
