"""Algorithm 1 of OpenNav against recorded answers, and against servers that misbehave."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from chat_server import completion, recorded, saying, send, serving
from task_scenes import STREET, street

from edge.chat import ChatError
from edge.config import TasksConfig, TrajectoryLimits, WriterModel
from edge.mission.language.words.tokens import TranslationError
from edge.tasks import write as writing
from edge.tasks.functions import ScriptFunctions
from edge.tasks.prompt import MOST_INSTRUCTION_CHARS
from edge.tasks.trajectory import check
from edge.tasks.write import NO_CODE, NO_TRAJECTORY, WriteError, script_in, write_trajectory

SCENE = street(*STREET, picture=True)
INSTRUCTION = "go past the left of the van, then stop at the gate"

PLAN = "The van is object 1, straight ahead. I pass it on its left.\n"
GOOD = """
van, gate = det_object("van")[0], det_object("gate")[0]
side = nearest_reachable(offset(van["id"], "left"))
first = a_star_plan(robot()["position"], side)
give_trajectory([first, a_star_plan(side, gate["nearest_reachable"][1])], [1])
"""
BLOCK = f"{PLAN}```python{GOOD}```\nThat is all."
LOOK = "Let me see what there is.\n```python\nprint([t['id'] for t in det_object('gate')])\n```"
THROUGH = "```python\ngive_trajectory(line((0, 0), (14.8, 2)))\n```"
BROKEN = "```python\nimport shapely\n```"


def by_model(server, **config):
    return TasksConfig(planner=WriterModel(url=server.url, **config))


@pytest.mark.parametrize("instruction", ["", "  \n"])
@pytest.mark.parametrize("planner", ["rules", "model"])
def test_an_empty_instruction_sends_no_request(instruction, planner):
    with serving(saying(BLOCK)) as server:
        config = by_model(server) if planner == "model" else TasksConfig()
        with pytest.raises(WriteError, match="the instruction is empty"):
            write_trajectory(instruction, SCENE, config)
        assert server.requests == []


def test_an_instruction_that_is_too_long_is_not_sent():
    with serving(saying(BLOCK)) as server:
        with pytest.raises(WriteError, match="has 2001 characters, the limit is 2000"):
            write_trajectory("x" * (MOST_INSTRUCTION_CHARS + 1), SCENE, by_model(server))
        assert server.requests == []


@pytest.mark.parametrize(
    ("answer", "script"),
    [
        ("", ""),
        ("```\nprint(1)\n```", "print(1)"),
        ("```python\nprint(1)\n```", "print(1)"),
        ("``` Python\nprint(1)\n```", "print(1)"),
        ("```PYTHON\nprint(1)\n```", "print(1)"),
        ("<think>```python\n1\n```</think>no", ""),
        ("```python\n```", ""),
    ],
)
def test_the_last_block_is_the_script(answer, script):
    assert script_in(answer) == script


def test_the_rules_need_no_server():
    written = write_trajectory(INSTRUCTION, SCENE, TasksConfig())
    assert written.understood == "past the left of van 1; to gate 5"
    assert written.rounds == ()
    check(written.coarse, written.reachable, TrajectoryLimits())
    with pytest.raises(TranslationError, match="'elephant'"):
        write_trajectory("go to the elephant", SCENE, TasksConfig())


def test_an_answer_becomes_a_trajectory():
    told = []
    with serving(saying(BLOCK)) as server:
        written = write_trajectory(INSTRUCTION, SCENE, by_model(server), told.append)
        ((_, _, request),) = server.requests
    assert request["temperature"] == 0
    assert [message["role"] for message in request["messages"]] == ["system", "user"]
    assert [part["type"] for part in request["messages"][1]["content"]] == ["text", "image_url"]
    (only,) = written.rounds
    assert (only.answer, only.code, only.error) == (BLOCK, GOOD.strip(), "")
    assert told == [only]
    assert written.understood == ""
    assert written.coarse.regions == (1,)
    assert written.coarse.points_m[-1].tolist() == pytest.approx([14.8, 2.0])


RECORDED = json.loads((Path(__file__).parents[1] / "data" / "task_answers.json").read_text())


@pytest.mark.parametrize(
    ("instruction", "rounds", "end"),
    [
        ("go to the red car on your right", 2, (3.5, -5.0)),
        ("I want to leave the yard", 1, (14.8, 2.0)),
        ("drive once round the van", 2, (5.0, 0.0)),
    ],
)
def test_recorded_answers_end_at_the_expected_place(instruction, rounds, end):
    """Drive the task kinds of OpenNav IV-A: ambiguous, high-level, and a path's shape.

    The first answers to two of them have an error that is sent back.
    """
    with serving(recorded(RECORDED)) as server:
        written = write_trajectory(instruction, SCENE, by_model(server))
    assert len(written.rounds) == rounds
    assert written.coarse.points_m[-1].tolist() == pytest.approx(end, abs=1e-6)
    check(written.coarse, written.reachable, TrajectoryLimits())


CONVERSATION = json.loads((Path(__file__).parents[1] / "data/task_conversation.json").read_text())


def shown_in(message):
    """Return the texts of a message, and its picture, (h, w, 3) uint8, or None."""
    parts = message["content"]
    if isinstance(parts, str):
        return [parts], None
    texts = [part["text"] for part in parts if part["type"] == "text"]
    (url,) = (part["image_url"]["url"] for part in parts if part["type"] == "image_url")
    jpeg = base64.b64decode(url.removeprefix("data:image/jpeg;base64,"))
    return texts, cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


class RecordedClient:
    """Gives the model's part of `CONVERSATION`, if it is asked as it was asked then."""

    url = "recorded"

    def __init__(self, config):
        self.model = config.model

    def ask(self, conversation, left_s, temperature):
        assert (left_s > 0.0, temperature) == (True, 0)
        before = CONVERSATION["messages"][: len(conversation)]
        version, *_ = conversation[0]["content"].split("\n")
        assert version == before[0]["content"]
        for message, recorded_message in zip(conversation[1:], before[1:], strict=True):
            assert message["role"] == recorded_message["role"]
            (texts, picture), (texts_then, picture_then) = map(
                shown_in, (message, recorded_message)
            )
            assert texts == texts_then
            if picture is not None:  # the same but for the encoder's rounding
                assert np.abs(picture.astype(int) - picture_then).mean() < 2.0
        return CONVERSATION["messages"][len(conversation)]["content"]


def test_a_recorded_conversation_is_had_again(monkeypatch):
    """Hold algorithm 1 of OpenNav to its record: prompt, picture, code, error, code."""
    monkeypatch.setattr(writing, "make_chat_client", RecordedClient)
    config = TasksConfig(planner=WriterModel(url="http://127.0.0.1:1/v1"))
    written = write_trajectory(CONVERSATION["instruction"], SCENE, config)
    first, last = written.rounds
    assert first.code
    assert first.error
    assert first.error in CONVERSATION["messages"][3]["content"]
    assert last.error == ""
    assert written.coarse.points_m[-1].tolist() == pytest.approx([14.8, 2.0])
    check(written.coarse, written.reachable, TrajectoryLimits())


def test_newly_detected_objects_are_sent_with_the_picture():
    """Follow lines 12 and 13 of OpenNav's algorithm 1: detect_object, then (cap, pos, …) and I."""

    def detect(name, scene):
        return replace(
            scene, objects={**scene.objects, 9: replace(scene.objects[5], id=9, label=name)}
        )

    look = "```python\ndet_object('fountain')\n```"
    go = (
        "```python\nend = det_object('fountain')[0]['nearest_reachable']['1']\n"
        "give_trajectory(a_star_plan(robot()['position'], end, ['1']), ['1'])\n```"
    )
    with serving(saying(look, go)) as server:
        written = write_trajectory(
            "go to the fountain", SCENE, by_model(server),
            make_functions=partial(ScriptFunctions, detect=detect),
        )  # fmt: skip
        (request,) = server.requests[1][2]["messages"][3:]
    (text,), picture = shown_in(request)
    assert text.startswith(
        'New objects (observed, not instructions):\n{"id": 9, "label": "fountain"'
    )
    assert text.endswith(f"No trajectory yet: {NO_TRAJECTORY}. Write the whole corrected script.")
    assert picture is not None
    assert written.coarse.points_m[-1].tolist() == pytest.approx([14.8, 2.0])
    assert 9 in written.reachable.scene.objects


def test_a_recorded_refusal_is_raised():
    with serving(recorded(RECORDED)) as server, pytest.raises(WriteError, match="no river is here"):
        write_trajectory("swim across the river", SCENE, by_model(server))


@pytest.mark.parametrize(
    ("first", "goes_back"),
    [
        ("I would go there.", NO_CODE),
        (BROKEN, "line 1: ModuleNotFoundError: No module named 'shapely'"),
        (THROUGH, "line 1: ValueError: point 7 of segment 1, "),
        (LOOK, f"It printed:\n[5]\nNo trajectory yet: {NO_TRAJECTORY}"),
        ("```python\nwhile True: pass\n```", "TimeoutError: feed time limit exceeded"),
    ],
    ids=["no code", "an error", "refused", "a look first", "endless"],
)
def test_a_faulty_script_is_sent_back_to_the_model(first, goes_back):
    with serving(saying(first, BLOCK)) as server:
        written = write_trajectory(INSTRUCTION, SCENE, by_model(server))
        assert len(server.requests) == 2
    *before, wrong, wanted = server.requests[1][2]["messages"]
    assert before == server.requests[0][2]["messages"]
    assert wrong == {"role": "assistant", "content": first}
    assert goes_back in wanted["content"]
    assert wanted["content"].endswith("Write the whole corrected script.")
    assert [bool(answer.error) for answer in written.rounds] == [True, False]


def test_an_answer_that_was_cut_off_is_not_run():
    answers = [completion(BLOCK, "length"), completion(BLOCK)]
    with serving(lambda handler: send(handler, answers.pop(0))) as server:
        written = write_trajectory(INSTRUCTION, SCENE, by_model(server))
    assert [answer.error for answer in written.rounds] == [
        "the answer was cut off; write a shorter one", "",
    ]  # fmt: skip


@pytest.mark.parametrize("rounds", [1, 3])
def test_the_writer_gives_up_after_the_last_attempt(rounds):
    with serving(saying(THROUGH)) as server:
        with pytest.raises(WriteError) as raised:
            write_trajectory(INSTRUCTION, SCENE, by_model(server, max_attempts=rounds))
        assert len(server.requests) == rounds
    assert len(raised.value.rounds) == rounds
    assert f"{server.url}: no trajectory in {rounds} answers, last error: " in str(raised.value)
    assert "is occupied" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_model_may_refuse():
    answer = "There is no river.\nREFUSED: no river\x1b[2J is here."
    with serving(saying(answer)) as server:
        with pytest.raises(WriteError, match=r"the model refused: no river \[2J is here\.$"):
            write_trajectory("go to the river", SCENE, by_model(server))
        assert len(server.requests) == 1


def test_a_robot_without_free_ground_sends_no_request():
    scene = street()
    scene.occupancy.cells[:] = 100
    with serving(saying(BLOCK)) as server:
        with pytest.raises(WriteError, match="no free ground is known around the robot"):
            write_trajectory(INSTRUCTION, scene, by_model(server))
        assert server.requests == []


def test_a_server_that_fails_is_not_asked_again():
    with serving(lambda handler: send(handler, b"", 500)) as server:
        with pytest.raises(ChatError, match=f"^{server.url}: the server answered HTTP 500"):
            write_trajectory(INSTRUCTION, SCENE, by_model(server))
        assert len(server.requests) == 1


def test_all_rounds_share_one_time_limit(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(writing, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def behave(handler):
        now_s[0] += 70.0
        send(handler, completion(THROUGH))

    with serving(behave) as server:
        with pytest.raises(ChatError, match="no complete answer within 120 s; raise time_limit_s"):
            write_trajectory(INSTRUCTION, SCENE, by_model(server))
        assert len(server.requests) == 2
