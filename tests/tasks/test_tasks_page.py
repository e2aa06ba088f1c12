"""docs/tasks.md: its sentences, its configuration and its code work as described."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from edge.config import TasksConfig, load
from edge.errors import UserError
from edge.lab.eval.trial.scene_capture import capture_street
from edge.tasks.functions import NAMES
from edge.tasks.scene.pipeline import run_pipeline
from edge.tasks.write import write_trajectory
from edge.types import Detections, Observation

PAGE = (Path(__file__).parents[2] / "docs/tasks.md").read_text(encoding="utf-8")
UNDERSTOOD, REFUSED = (
    re.findall(r"^\| `([^`|]+)` \| ([^|`]+) \|$", part, re.MULTILINE)
    for part in PAGE.partition("| you say | it reads |")[2]
    .partition("## A model")[0]
    .split("| you say | it answers |")
)
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@cache
def scene():
    return capture_street(3, load("street")).scene


def test_the_page_has_its_tables():
    assert len(UNDERSTOOD) == 23
    assert len(REFUSED) == 8


@pytest.mark.parametrize(("words", "understood"), UNDERSTOOD)
def test_documented_instructions_are_understood(words, understood):
    assert write_trajectory(words, scene(), load("street").tasks).understood == understood


@pytest.mark.parametrize(("words", "answer"), REFUSED)
def test_documented_refusals_are_given(words, answer):
    with pytest.raises(UserError, match=re.escape(answer.strip())):
        write_trajectory(words, scene(), load("street").tasks)


def test_the_page_names_every_function():
    assert [name for name in NAMES if f"{name}(" not in PAGE] == []


@pytest.mark.parametrize("text", [text for kind, text in BLOCKS if kind == "yaml"])
def test_the_configurations_of_the_page_are_valid(text):
    """Apart from the model's name and address they show only defaults."""
    given = yaml.safe_load(text)["tasks"]
    tasks, default = TasksConfig.model_validate(given), TasksConfig()
    assert tasks.trajectory == default.trajectory
    if "planner" in given:
        planner = type(tasks.planner)()
        assert tasks.planner == planner.model_copy(update={"model": "MODEL"})


def test_the_plugin_pipeline_of_the_page_runs():
    (code,) = (text for kind, text in BLOCKS if kind == "python")
    picture = Observation(0, 0, np.eye(4), rgb=np.zeros((20, 30, 3), np.uint8))

    def my_detector(observation, tags):
        box = np.array([[1, 2, 10, 12]], np.float32)
        return Detections(
            observation, box, np.ones(1, np.float32), np.ones(1, np.int32), tuple(tags)
        )

    names = {"my_detector": my_detector}
    exec(code, names)
    assert run_pipeline(names["my_pipeline"](("sofa",)), picture).caption == ("a person",)
