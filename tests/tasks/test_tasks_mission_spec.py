"""From a task in words to the detector's targets."""

from __future__ import annotations

import pytest
from simulated import simulated

from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Place, Site
from edge.mission.repetition import Repetition
from edge.mission.translate import TranslationError
from edge.tasks.mission_spec import prepare_mission, prepare_task

RULES = simulated({"mission": {"target": "bed", "max_targets": 3}})
BENCH = Site((Place("bench", SE2(1.0, 2.0, 0.0)),))
RED_BENCH = Site((Place("red bench", SE2(1.0, 2.0, 0.0)),))
MODEL = simulated({"tasks": {"planner": {"kind": "model"}}, "mission": {"target": "bed"}})


@pytest.mark.parametrize(
    ("config", "task", "targets", "to_see"),
    [
        (RULES, "go straight for 3 metres", ("bed",), [()]),
        (
            RULES,
            "go past the couch and stop at the desk",
            ("couch", "desk"),
            [("couch",), ("desk",)],
        ),
        (RULES, "go to the couch, then left of the sofa, then stop", ("couch",), [("couch",)] * 2),
        (
            RULES,
            "go around the bed, then to the desk, then stop",
            ("bed", "desk"),
            [("bed", "desk"), ("desk",)],
        ),
        (RULES, "go around the bed, then stop", ("bed",), [("bed",)]),
        (MODEL, "circle something", ("bed",), [()]),
        (MODEL, "Circle the couch; keep off potted plants.", ("couch", "potted plant"), [()]),
    ],
)
def test_objects_named_by_a_task_become_targets(config, task, targets, to_see):
    spec = prepare_task(config, task)
    assert (spec.targets, [step.names for step in spec.steps]) == (targets, to_see)
    assert spec.translation.instruction == spec.translation.understood == task


@pytest.mark.parametrize(
    ("config", "task", "said"),
    [
        (RULES, "", "task: empty"),
        (MODEL, " \n", "task: empty"),
        (MODEL, "x" * 2001, "the limit is 2000"),
        (RULES, "dance", "did not understand 'dance'"),
        (RULES, "go to the bed, the sofa, to the desk and to the car", "did not understand"),
        (RULES, "go past the bed, past the sofa, past the desk and to the car", "at most 3"),
    ],
)
def test_an_invalid_task_is_refused_in_one_line(config, task, said):
    with pytest.raises(UserError) as caught:
        prepare_task(config, task)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_task_a_mission_is_prepared():
    assert prepare_mission(RULES).steps is None
    assert prepare_mission(RULES, formula="F sofa").targets == ("sofa",)


@pytest.mark.parametrize(
    ("instruction", "said"),
    [
        ("turn left, then go to the bed", ["turn left", "go to the bed"]),
        ("please stop 2 m before the sofa", ["stop 2 m before the sofa"]),
        ("circle around the sofa", ["circle around the sofa"]),
        ("go past the right of the bench", ["go past the right of the bench"]),
        ("drive past the bed and stop at the sofa", ["drive past the bed", "stop at the sofa"]),
        ("go past the bed", None),
        ("go past the bed and stop at the sofa; avoid the desk", None),
        ("go past the kitchen to the bed", None),
        ("go to the bed", None),
    ],
)
def test_an_instruction_about_a_path_becomes_a_task(instruction, said):
    spec = prepare_mission(RULES, instruction=instruction)
    assert (spec.steps and [step.said for step in spec.steps]) == said
    assert spec.translation.instruction == instruction
    configured = simulated({"mission": {"instruction": instruction}})
    assert prepare_mission(configured).targets == spec.targets
    assert prepare_mission(configured, formula="F bed").steps is None


@pytest.mark.parametrize(
    ("request_fields", "reason"),
    [
        ({"instruction": "go left"}, "expected where: to, past, around"),
        ({"instruction": "go straight"}, "say how far"),
        ({"instruction": "turn left at the dokk"}, "did not understand 'left'"),
        (
            {"instruction": "go past the right of the bench", "site": BENCH},
            "'the right of \"bench\"'",
        ),
        ({"instruction": "go to the kitchen, then turn left"}, "did not understand 'left'"),
        ({"instruction": "turn left at the blorb sofa"}, "did not understand 'left'"),
        ({"instruction": "circle all chairs"}, "not a known object"),
        ({"instruction": "turn left, then wait"}, "did not understand 'left'"),
        ({"instruction": "turn left at 5 pm"}, "say first when, then where to go"),
        ({"instruction": "behind the sofa at 5 pm"}, "say first when, then where to go"),
        ({"instruction": "find a mug and turn left"}, "character 21: did not understand 'left'"),
        ({"instruction": "go past the sofa in an hour"}, "times and distances cannot be used"),
        ({"instruction": "turn left at the red bench", "site": RED_BENCH}, "'left'"),
        ({"instruction": "go to the sofa exactly"}, "did not understand 'exactly'"),
        ({"instruction": "turn left", "repeat": Repetition(2)}, "did not understand 'left'"),
        ({"instruction": "go slowly past the sofa and stop at the bed"}, "how fast it drives"),
        ({"instruction": "dance past the sofa"}, "'dance': the robot answers"),
    ],
)
def test_an_instruction_that_is_neither_mission_nor_path_is_refused(request_fields, reason):
    with pytest.raises(TranslationError, match=reason):
        prepare_mission(RULES, **request_fields)


def test_a_formula_is_no_path():
    config = simulated({"mission": {"translator": {"kind": "ltl"}}})
    with pytest.raises(UserError):
        prepare_mission(config, instruction="turn left")
