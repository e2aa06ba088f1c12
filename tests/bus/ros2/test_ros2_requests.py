"""Requests from the ROS 2 graph: each has one answer, with its label."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from patience import eventually
from ros_messages import STORE, from_ros, to_ros
from ros_router import ours, router, zenoh_settings
from simulated import simulated

from edge.bus import topics
from edge.bus.request_queue import MAX_BYTES, RequestQueue
from edge.bus.ros2.names import RMW_ZENOH, dialect_of
from edge.bus.ros2.node import Ros2Node
from edge.bus.ros2.requests import BOOL, STRING, serve_ros2_requests, serve_ros2_stop
from edge.bus.verbs import Verb
from edge.bus.wire.cdr import HEADER

KEYS = [key.removesuffix("/request") for key in topics.REQUESTS]
Ask = Callable[[bytes], dict[str, Any]]


def string(text: str) -> bytes:
    return to_ros(STORE.types[STRING](text))


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with router() as port:
        yield port


@pytest.fixture(params=["rmw_zenoh", "bridge", "adapter"])
def ask(request, port) -> Iterator[Ask]:
    """Send a message until an answer comes; the loop only knows `list` and `remove`."""
    config = simulated({"ros2": {"via": request.param, "requests": True}})
    config = config.model_copy(update={"zenoh": zenoh_settings(port)})
    verbs = {"list": Verb(read_only=True), "remove": Verb(("name",), dict)}
    queues = {
        key: RequestQueue(key, verbs, lambda request, _: {"did": request.do, **request.fields})
        for key in topics.REQUESTS
    }
    with ours(port) as theirs, ours(port) as session, serve_ros2_requests(config, session, queues):
        node = Ros2Node(theirs, 0, "operator", dialect_of(request.param, config.zenoh.prefix))
        sent, heard = node.publisher("/edge/request", STRING), []
        answers = node.subscription("/edge/answer", (STRING,), 8)

        def ask(payload: bytes) -> dict[str, Any]:
            node.update()
            eventually(lambda: node.update() or sent.has_subscribers())
            sent.put(payload)

            def answer() -> list:
                for queue in queues.values():
                    queue.serve(0)
                heard.extend(answers.take())
                return heard

            ((type_name, payload),) = eventually(answer)
            heard.clear()
            return json.loads(from_ros(payload.to_bytes(), type_name).data)

        yield ask
        node.close()
    for queue in queues.values():
        queue.close()


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("", {"error": "the request is not JSON"}),
        ("[]", {"error": "the request is JSON, but not an object"}),
        ("{}", {"error": f"to: unknown None (choices: {', '.join(KEYS)})"}),
        ('{"to": "site"}', {"to": "site", "error": "do: unknown None (choices: list, remove)"}),
        ('{"to": "memory", "do": "list", "ref": 7}', {"to": "memory", "ref": 7, "did": "list"}),
        (
            '{"to": "site", "do": "remove", "name": "dock"}',
            {"to": "site", "did": "remove", "name": "dock"},
        ),
        (
            '{"to": "site", "do": "list", "ref": [1]}',
            {"error": "ref: expected an integer, or text of at most 100 characters, got a list"},
        ),
    ],
)
def test_each_request_is_answered_with_its_label(ask, text, answer):
    assert ask(string(text)) == answer


@pytest.mark.parametrize(
    ("payload", "error"),
    [(b"junk", "not little-endian CDR"), (string("x" * MAX_BYTES), "bytes, at most 65536")],
)
def test_an_invalid_request_gets_an_error_reply(ask, payload, error):
    assert error in ask(payload)["error"]


@pytest.mark.parametrize("via", ["rmw_zenoh", "bridge", "adapter"])
def test_only_a_pressed_button_stops_the_robot(port, via):
    config = simulated({"ros2": {"via": via}})
    config = config.model_copy(update={"zenoh": zenoh_settings(port)})
    reasons: list[str] = []
    with (
        ours(port) as theirs,
        ours(port) as session,
        serve_ros2_stop(config, session, reasons.append),
    ):
        node = Ros2Node(theirs, 0, "button", dialect_of(via, config.zenoh.prefix))
        button = node.publisher("/edge/stop", BOOL)
        eventually(lambda: node.update() or button.has_subscribers())
        for payload, presses in ((to_ros(STORE.types[BOOL](False)), 0), (b"junk", 1),
                                 (to_ros(STORE.types[BOOL](True)), 2)):  # fmt: skip
            button.put(payload)
            eventually(lambda presses=presses: len(reasons) >= presses)
            assert len(reasons) == presses
        node.close()
    assert set(reasons) == {"a message on /edge/stop"}


@pytest.mark.parametrize(
    ("type_name", "payload", "latched"),
    [(BOOL, to_ros(STORE.types[BOOL](True)), True), (STRING, HEADER + b"\0", False)],
    ids=["pressed before the start", "another type"],
)
def test_a_latched_message_and_one_of_another_type_stop_the_robot(
    port, type_name, payload, latched
):
    config = simulated()
    config = config.model_copy(update={"zenoh": zenoh_settings(port)})
    reasons: list[str] = []
    with ours(port) as theirs, ours(port) as session:
        node = Ros2Node(theirs, 0, "button", RMW_ZENOH)
        button = node.publisher("/edge/stop", type_name, latched)
        if latched:
            button.put(payload)
        with serve_ros2_stop(config, session, reasons.append):
            if not latched:
                eventually(lambda: node.update() or button.has_subscribers())
                button.put(payload)
            eventually(lambda: reasons)
        node.close()
