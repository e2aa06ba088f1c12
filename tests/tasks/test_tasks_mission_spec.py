"""From a task in words to the detector's targets."""

from __future__ import annotations

import pytest
from simulated import simulated

from edge.errors import UserError
from edge.tasks.mission_spec import prepare_mission, prepare_task

RULES = simulated({"mission": {"target": "bed", "max_targets": 3}})
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
