"""Questions after exploring."""

from __future__ import annotations

import pytest
from small_house import small_house

from edge.errors import UserError
from edge.lab.eval.arms import make_arms
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.drive import run_episode
from edge.lab.eval.questions import plan_questions


def config_of(folder, **detector):
    perception = {"detector": {"kind": "sim", **detector}}
    mission = {"time_limit_s": 60.0}
    return small_house(folder, mission=mission, sim={"step_s": 0.2}, perception=perception)


def test_only_objects_in_the_world_are_asked_about(tmp_path):
    config = config_of(tmp_path)
    with pytest.raises(UserError, match="no world has any of the targets"):
        plan_questions(config, [], ["unicorn"], 0)
    (planned,) = plan_questions(config, [], ["unicorn", "bed", "sofa"], 0)
    assert planned.asks == ("bed", "sofa")


@pytest.mark.parametrize(
    ("background", "expected"),
    [(None, {"bed": "right", "sofa": "right"}), (["bed"], {"bed": "right", "sofa": "not seen"})],
)
def test_answers_are_judged_by_the_world(tmp_path, background, expected):
    config = config_of(tmp_path, background=background)
    (planned,) = plan_questions(config, [], ["bed", "sofa"], 0)
    (arm,) = make_arms(config, {"search": {"policy": {"kind": "search"}}})
    outcome = run_episode(arm, planned)
    assert outcome.success, outcome.reason
    assert outcome.answers == expected
    found = gather([outcome])
    share = sum(verdict == "right" for verdict in expected.values()) / 2
    assert found["answers_right"].item() == share
