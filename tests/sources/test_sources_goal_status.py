"""Goal statuses of controllers, valid and invalid."""

from __future__ import annotations

import json

import pytest

from edge.sources.goal_status import parse_goal_status
from edge.text import MAX_CHARS
from edge.types import GoalStatus


@pytest.mark.parametrize("state", ["accepted", "reached", "failed"])
def test_an_answer(state):
    payload = json.dumps({"stamp": 123, "state": state, "reason": "why", "extra": 1}).encode()
    assert parse_goal_status(payload) == GoalStatus(123, state, "why")
    assert parse_goal_status(json.dumps({"stamp": 1, "state": state}).encode()).reason == ""


@pytest.mark.parametrize("stamp", [0, -1, 2**31 * 10**9, -(2**63), 2**63 - 1, 10**30])
def test_any_integer_is_a_valid_stamp(stamp):
    payload = json.dumps({"stamp": stamp, "state": "reached"}).encode()
    assert parse_goal_status(payload).stamp_ns == stamp


def test_a_stamp_may_be_written_as_a_double():
    payload = b'{"stamp": 1.7857e18, "state": "reached"}'
    assert parse_goal_status(payload).stamp_ns == 1_785_700_000_000_000_000


def test_a_goal_status_gives_the_blocked_place():
    payload = b'{"stamp": 1, "state": "accepted", "blocked": [1, -2.5]}'
    assert parse_goal_status(payload).blocked == (1.0, -2.5)


@pytest.mark.parametrize(
    "blocked",
    ["3", "[]", "[1]", "[1, 2, 3]", '["1", 2]', "[true, 2]", "[NaN, 0]", "[0, Infinity]",
     "[1e7, 0]", "[0, 1" + 400 * "0" + "]", '{"x": 1}'],
)  # fmt: skip
def test_an_invalid_blocked_place_is_refused(blocked):
    payload = f'{{"stamp": 1, "state": "accepted", "blocked": {blocked}}}'.encode()
    with pytest.raises(ValueError, match=r"blocked: expected \[x, y\] in metres"):
        parse_goal_status(payload)


def test_a_reason_is_cut_to_one_short_line():
    said = "stuck\n12:00 info mission:\x1b[31m reached\u202e\0" + "!" * 3000
    answer = parse_goal_status(json.dumps({"stamp": 1, "state": "failed", "reason": said}).encode())
    assert answer.reason.startswith("stuck 12:00 info mission: [31m reached !!!")
    assert len(answer.reason) == MAX_CHARS


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"", "not JSON"),
        (b"\xff", "not JSON"),
        (b"[]", "not a JSON object"),
        (b'{"state": "reached"}', "stamp: expected an integer .ns., got None"),
        (b'{"stamp": 1, "state": "done"}', "unknown 'done'"),
        (b'{"stamp": 1, "state": ["reached"]}', "unknown"),
        (b'{"stamp": 1, "state": "failed", "reason": 3}', "reason: expected text"),
        (b" " * 5000, "at most 4096"),
    ],
)
def test_no_answer(payload, text):
    with pytest.raises(ValueError, match=text) as caught:
        parse_goal_status(payload)
    assert "\n" not in str(caught.value)
