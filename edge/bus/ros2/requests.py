"""Server of requests to the running service over two ROS 2 topics, for nodes without Zenoh.

A request is a std_msgs/String with JSON: `{"to": "site", "do": "list", "ref": 7}`. `to` names the
requests (`mission`, `models`, `site`, `memory`, `stop`, `release`), `ref` is optional. The answer
is a std_msgs/String on the other topic: the JSON of the answer, with the `to` and `ref` of its
request. Every node of the graph may send requests and hears all answers.

A std_msgs/Bool on the topic `stop` stops the robot, without any setting: true is a pressed button.
So does any message of another type, such as std_msgs/Empty.
"""

from __future__ import annotations

import json
import queue
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from typing import Any

import zenoh

from edge.bus import topics
from edge.bus.request_queue import MAX_BYTES, RequestQueue
from edge.bus.ros2.node import Ros2Node, open_node
from edge.bus.stop import StopRequests
from edge.bus.verbs import error_payload, show
from edge.bus.wire.cdr import HEADER, CdrReader, CdrWriter, DecodeError
from edge.config import Config
from edge.host.periodic import run_periodically

STRING, BOOL = "std_msgs/msg/String", "std_msgs/msg/Bool"
POLL_S = 0.05
"""Period of polls."""
STOP_POLL_S = 0.01
"""Period of polls of the topic `stop`."""
_RING_MESSAGES = 16
_MAX_REF_CHARS = 100
# Value of `to` -> key of its requests.
_KEYS = {key.removesuffix("/request"): key for key in topics.REQUESTS}


class Ros2RequestServer:
    """Passes requests to the queues of the loop, and publishes the answers."""

    def __init__(
        self,
        node: Ros2Node,
        request_topic: str,
        answer_topic: str,
        queues: Mapping[str, RequestQueue | StopRequests],
    ) -> None:
        self._node, self._queues = node, queues
        self._requests = node.subscription(request_topic, (STRING,), _RING_MESSAGES)
        self._answers = node.publisher(answer_topic, STRING)
        self._pending: queue.SimpleQueue[tuple[dict[str, Any], bytes]] = queue.SimpleQueue()

    def poll(self) -> None:
        """Pass on requests and publish answers; one thread must call this every `POLL_S`."""
        self._node.update()
        for _, payload in self._requests.take():
            self._receive(payload)
        while not self._pending.empty():
            label, reply = self._pending.get()
            text = json.dumps({**label, **json.loads(reply)})
            self._answers.put(CdrWriter().string(text).bytes())

    def close(self) -> None:
        self._node.close()

    def _receive(self, payload: zenoh.ZBytes) -> None:
        """Pass a message to the queue of its requests, or answer with an error."""
        label: dict[str, Any] = {}
        reply = partial(self._reply, label)
        try:
            request = _read_message(payload)
            label |= {name: request.pop(name) for name in ("to", "ref") if name in request}
            accept = self._accept_of(label.get("to"))
        except ValueError as error:
            reply(error_payload(str(error)), True)
        else:
            accept(json.dumps(request).encode(), reply)

    def _accept_of(self, to: object) -> Callable[..., None]:
        """Return the method that accepts requests to this destination."""
        served = [name for name, key in _KEYS.items() if key in self._queues]
        if not isinstance(to, str) or to not in served:
            raise ValueError(f"to: unknown {show(to)} (choices: {', '.join(served)})")
        return self._queues[_KEYS[to]].accept

    def _reply(self, label: dict[str, Any], reply: bytes, is_error: bool) -> None:
        self._pending.put((label, reply))


@contextmanager
def serve_ros2_requests(
    config: Config, session: zenoh.Session, queues: Mapping[str, RequestQueue | StopRequests]
) -> Iterator[None]:
    """Take requests from the ROS 2 graph until the block ends; see `Ros2RequestServer`."""
    node, settings = open_node(config, session, "requests"), config.ros2
    server = Ros2RequestServer(
        node, settings.topic("request"), settings.topic("answer"), queues
    )  # fmt: skip
    with closing(server), run_periodically("ros2-requests", POLL_S, server.poll):
        yield


@contextmanager
def serve_ros2_stop(
    config: Config, session: zenoh.Session, stop: Callable[[str], object]
) -> Iterator[None]:
    """Stop the robot at each true message on the topic `stop`, until the block ends.

    A message of another type than Bool stops it, too. Latched messages from before count.
    """
    node, topic = open_node(config, session, "stop"), config.ros2.topic("stop")
    pressed = node.subscription(topic, (BOOL,), _RING_MESSAGES, latched=True)

    def poll() -> None:
        node.update()
        # The byte after the header is the value. A malformed message stops the robot, too.
        if any(
            type_name != BOOL or payload.to_bytes()[len(HEADER) :][:1] != b"\0"
            for type_name, payload in pressed.take()
        ):
            stop(f"a message on {topic}")

    with closing(node), run_periodically("ros2-stop", STOP_POLL_S, poll):
        yield


def _read_message(payload: zenoh.ZBytes) -> dict[str, Any]:
    """Return the request of a message.

    Raises:
        ValueError: it is too long, no JSON object, or its `ref` is no number or short text.
    """
    if len(payload) > MAX_BYTES:
        raise ValueError(f"the request has {len(payload)} bytes, at most {MAX_BYTES} are allowed")
    try:
        request = json.loads(CdrReader(payload.to_bytes()).string())
    except DecodeError:
        raise
    except (ValueError, RecursionError):
        raise ValueError("the request is not JSON") from None
    if not isinstance(request, dict):
        raise ValueError("the request is JSON, but not an object")
    ref = request.get("ref", "")
    if not isinstance(ref, int | str) or len(str(ref)) > _MAX_REF_CHARS:
        raise ValueError(
            f"ref: expected an integer, or text of at most {_MAX_REF_CHARS} characters, "
            f"got {show(ref)}"
        )
    return request
