"""The status message's words about a task: all that counts, and never too much of it."""

from __future__ import annotations

import json
from dataclasses import replace

from results import facts, result
from task_facts import HOSTILE, INSTRUCTION, by_a_model, driving, written

from edge.loop.status import MOST_ATTEMPTS, MOST_POSES, reply_json, status_message, task_json
from edge.tasks.refine import RefinedTrajectory
from edge.types import MissionStatus

MOST_BYTES = 64_000  # it goes out each second


def long_one() -> RefinedTrajectory:
    """5,000 poses."""
    refined = written()[1]
    poses = refined.poses[[0] * 4000 + list(range(len(refined.poses))) * 9][:5000]
    return replace(refined, poses=poses)


def test_a_task_that_is_driven():
    task = driving(index=40)
    said = status_message(result(task=lambda: task))["task"]
    assert said == reply_json(MissionStatus("van", "approaching"), facts(), task)["task"]
    assert (said["instruction"], said["writer"]) == (INSTRUCTION, "rules")
    assert said["understood"] == task.understood
    x_m, y_m, heading_rad = said["trajectory"][-1]
    assert [x_m, y_m, heading_rad] == task.refined.poses[-1, [0, 1, 3]].round(3).tolist()
    assert 0 < said["driven_m"] < said["length_m"]
    assert said["trajectory"][said["index"]] == task.refined.poses[40, [0, 1, 3]].round(3).tolist()


def test_text_of_a_model_is_shown_without_control_characters():
    said = task_json(by_a_model())
    first, second = said["rounds"]
    assert (first["code"], first["error"][:14]) == ("", "the answer has")
    assert (second["error"], second["printed"].splitlines()[0]) == ("", "1")
    assert second["code"].splitlines()[1:] == ["print(1)", "give_trajectory([(1, 0)])"]
    words = json.dumps(said, ensure_ascii=False)
    assert all(c.isprintable() for c in words)


def test_however_much_a_model_says_the_message_stays_small():
    task = by_a_model(250 * "x\x1b\n" + HOSTILE + 256_000 * "y")
    task = replace(task, rounds=task.rounds * 10, refined=long_one(), index=4321)
    task = replace(
        task, missing=task.notes * 1000, notes=task.notes * 1000, steps=task.steps * 1000
    )
    said = task_json(replace(task, instruction=task.prompt, understood=task.prompt))
    assert (said["answers"], len(said["rounds"])) == (20, MOST_ATTEMPTS)
    assert len(said["trajectory"]) == MOST_POSES
    assert len(json.dumps(said)) < MOST_BYTES
