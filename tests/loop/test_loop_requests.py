"""Requests to the loop as JSON, and their results."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.bus.verbs import MAX_CHARS, Request, read_request
from edge.loop.requests.handlers import mission_verbs
from edge.loop.requests.model_requests import MODEL_VERBS, ModelRequests
from edge.perception.detection.sim import SimDetector
from edge.perception.swap.base import SwapError
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker

MISSION = mission_verbs(lambda **texts: texts)
VERB = st.sampled_from([*MISSION])


@pytest.mark.parametrize(
    ("verbs", "data", "more"),
    [
        (MISSION, {"do": "new", "instruction": "find the chair"}, {}),
        (MISSION, {"do": "new", "formula": "F chair"}, {}),
        (MISSION, {"do": "new", "instruction": "é" * MAX_CHARS}, {}),
        (MISSION, {"do": "new", "instruction": "find it", "reading": 2}, {}),
        (MISSION, {"do": "new", "formula": "F a", "id": "1f.2-3_4~5", "if_free": True}, {}),
        (MISSION, {"do": "cancel", "id": "a", "why": "another robot is at it"}, {}),
        *[(MISSION, {"do": verb}, {}) for verb in MISSION if verb != "new"],
        (MODEL_VERBS, {"do": "status"}, {}),
        (MODEL_VERBS, {"do": "use", "model": "a"}, {"force": False}),
        (MODEL_VERBS, {"do": "use", "model": "a", "force": True}, {}),
    ],
)
def test_a_request(verbs, data, more):
    expected = data["do"], {**{name: data[name] for name in data if name != "do"}, **more}
    assert read_request(json.dumps(data).encode(), verbs) == expected
    assert read_request(json.dumps(data, ensure_ascii=False).encode(), verbs) == expected


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"", "not JSON"),
        (b"\xff\x00", "not JSON"),
        (b"[]", "not a JSON object"),
        (b"{}", "do: unknown None (choices: new, pause, resume, confirm, cancel, again, status)"),
        (b'{"do": "stop"}', "do: unknown 'stop' (choices: new, "),
        (b'{"do": "pause", "why": 1}', "'why': not a field of do: pause (its fields: for_s)"),
        (b'{"do": "new", "formula": "F a", "x": 1}', "'x': not a field of do: new (its fields: "),
        (b'{"do": "new"}', "exactly one of the fields instruction, formula and task"),
        (b'{"do": "new", "formula": "a", "id": 3}', "id: expected text, got 3"),
        (b'{"do": "new", "formula": "a", "reading": 1}', "only valid with the field instruction"),
        (
            b'{"do": "new", "instruction": "a", "reading": 0}',
            "the number of a reading, 1 or more, got 0",
        ),
        (b'{"do": "cancel", "id": "a b"}', "id: expected at most 64 letters, digits and"),
        (b'{"do": "cancel", "id": "%s"}' % (b"a" * 65), "at most 64"),
        (b'{"do": "cancel", "why": ""}', "why: expected text, got ''"),
        (b'{"do": "new", "formula": "a", "if_free": 1}', "if_free: expected true or false"),
        (b'{"do": "new", "instruction": " \\n"}', "instruction: expected text, got ' \\n'"),
        (b'{"do": "new", "instruction": "\\ud800"}', "instruction: not Unicode text"),
        (b'{"do": "new", "instruction": "' + b"a" * 10_001 + b'"}', "at most 10000"),
    ],
)
def test_no_request_about_the_mission(payload, text):
    refused(MISSION, payload, text)


def refused(verbs, payload, text):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        read_request(payload, verbs)
    assert text in str(caught.value)
    assert len(str(caught.value)) < 200
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"{}", "do: unknown None (choices: use, pause, resume, status)"),
        (b'{"do": ["use"]}', "do: unknown a list"),
        (b'{"do": "use"}', "model: expected text, got None"),
        (b'{"do": "use", "model": 3}', "model: expected text, got 3"),
        (b'{"do": "use", "model": "' + b"a" * 201 + b'"}', "model: 201 characters, at most 200"),
        (b'{"do": "use", "model": "a", "force": 1}', "force: expected true or false"),
        (b'{"do": "use", "model": "a", "why": 1}', "'why': not a field of do: use (its fields: "),
        (b'{"do": "status", "model": "a"}', "'model': not a field of do: status (its"),
    ],
)
def test_no_request_about_the_model(payload, text):
    refused(MODEL_VERBS, payload, text)


def parsed(payload: bytes) -> tuple[str, dict] | str:
    try:
        return read_request(payload, MISSION)
    except ValueError as error:
        return str(error)


@given(st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | VERB,
    lambda x: st.lists(x)
    | st.dictionaries(st.sampled_from(["do", "instruction", "formula", "id"]), x),
))  # fmt: skip
def test_any_json_is_a_request_or_a_value_error(data):
    request = parsed(json.dumps(data).encode())
    if isinstance(request, tuple):
        assert len(request[1].keys() & {"instruction", "formula"}) == (request[0] == "new")
    else:
        assert "\n" not in request


@pytest.mark.parametrize("depth", [100, 900, 990, 1000, 5000, 30_000])
def test_a_deep_nest_is_a_value_error(depth):
    nest = b"[" * depth + b"]" * depth
    for payload in (b'{"do": %s}' % nest, b'{"do": "new", "formula": %s}' % nest):
        assert isinstance(parsed(payload), str)


def test_a_model_request_is_answered_with_the_swap_state():
    perception = simulated().perception
    worker = DetectorWorker(SimDetector(perception.detector, ["chair"]), inline=True)
    swapper = DetectorSwap(perception, worker, lambda *_: None)

    handle = ModelRequests(swapper).handle

    def use(model: str) -> dict:
        return handle(Request("use", {"model": model, "force": False}), 0)

    assert handle(Request("status"), 0)["state"] == "idle"
    with pytest.raises(SwapError, match="runs already"):
        use(worker.detector.name)
    begun = use("nothing")
    assert (begun["model"], begun["number"]) == ("nothing", 1)
    swapper.close()
    json.dumps(begun)
