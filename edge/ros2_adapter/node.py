"""The adapter's node, run as a file by the robot's own ROS Python: rclpy, zenoh, no `edge`.

`python3 node.py` reads its plan, one line of JSON (see `edge.ros2_adapter.process`), from standard
input, and ends when that is closed. Messages are passed as the bytes that they are, from DDS only
while somebody hears them on Zenoh. The action's three services are queryables there, as
zenoh-bridge-ros2dds has them; only their requests and answers are opened, as rclpy wants it.

One thread does everything: Zenoh's messages are looked for between two callbacks of ROS.
"""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

log = logging.getLogger("edge.ros2_adapter")

LOOK_S = 0.005  # between two looks at what Zenoh brought
GRAPH_S = 0.2  # between two looks at who is there
PATIENCE_S = 5.0  # for a first message
GONE_S = 3.0  # nobody hears what is passed: nobody looks where the robot goes
SETTLE_S = 0.5  # for a goal to be cancelled at the end
_OPEN_AGAIN_S = 0.5
_CDR = b"\x00\x01"
_REQUEST_BYTES = 4096
_KEPT = 16
_HISTORY = 100  # latched messages, of all publishers of a topic


class Unusable(Exception):
    """Something that no restart mends; one line."""


class Ends(NamedTuple):
    """Where messages are passed between: a node of ROS and a session of Zenoh, and its package."""

    node: Any
    session: Any
    zenoh: Any


def main() -> int:
    """Run until standard input ends or a signal comes; returns an exit code of sysexits.h."""
    logging.basicConfig(level=logging.INFO, format="ros2-adapter: %(message)s", stream=sys.stderr)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    plan = json.loads(sys.stdin.readline())
    threading.Thread(target=_watch_input, args=(stop,), daemon=True).start()
    try:
        run(plan, stop)
    except Unusable as error:
        log.error("%s", error)
        return os.EX_UNAVAILABLE
    return os.EX_OK


def _watch_input(stop: threading.Event) -> None:
    """Whoever started the node holds the other end of its input: it must not outlive them.

    Read past Python's buffer, whose lock a thread must not hold when the interpreter ends.
    """
    while os.read(0, 4096):
        pass
    stop.set()


def run(plan: dict[str, Any], stop: threading.Event) -> None:
    """Pass messages until `stop` is set.

    Raises:
        Unusable: a package, a message or a Zenoh setting is not to be had here.
    """
    rclpy, zenoh = _imported("rclpy", plan), _imported("zenoh", plan)
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    session = _open(zenoh, plan, stop)
    if session is None:
        return
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(plan["node"], start_parameter_services=False)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        ends = Ends(node, session, zenoh)
        heard = [FromRos(ends, one, find_type(one["type"])) for one in plan["heard"]]
        said = [ToRos(ends, one, plan["max_bytes"]) for one in plan["said"]]
        action = None if plan["action"] is None else Action(ends, plan["action"])
        log.info("passes what is heard of %d topics in, %d out", len(heard), len(said))
        due_s = 0.0
        while not stop.is_set():
            executor.spin_once(timeout_sec=LOOK_S)
            for one in said:
                one.look()
            if action is not None:
                action.pass_requests()
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + GRAPH_S
                for one in heard:
                    one.look()
                if action is not None:
                    action.look(is_followed=any(one.wanted for one in heard))
        if action is not None and action.cancel():
            until_s = time.monotonic() + SETTLE_S
            while time.monotonic() < until_s:
                executor.spin_once(timeout_sec=LOOK_S)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
        session.close()


def _imported(name: str, plan: dict[str, Any]) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        what = {
            "rclpy": "source ROS 2's setup file first, or name it in ros2.adapter.setup",
            "zenoh": f"{sys.executable} -m pip install eclipse-zenoh=={plan['version']}",
        }[name]
        raise Unusable(f"{sys.executable}: no {name} ({error}): {what}") from None


def _open(zenoh: Any, plan: dict[str, Any], stop: threading.Event) -> Any:
    """A session with the service, waited for; None once `stop` is set."""
    try:
        config = zenoh.Config.from_json5(plan["zenoh"])
    except zenoh.ZError as error:
        versions = f"{plan['version']} of eclipse-zenoh wrote them"
        raise Unusable(f"zenoh: cannot read the session's settings ({versions}): {error}") from None
    told = False
    while not stop.is_set():
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if not told:
                told = True
                log.info("waiting for the service: %s", _line(str(error).split(" at /")[0]))
            stop.wait(_OPEN_AGAIN_S)
    return None


def find_type(name: str) -> Any:
    """The class of `package/msg/Name` or `package/action/Name`.

    Raises:
        Unusable: it is not installed.
    """
    package, kind, cls = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), cls)
    except (ImportError, AttributeError):
        debian = f"ros-{os.environ.get('ROS_DISTRO', '$ROS_DISTRO')}-{package.replace('_', '-')}"
        raise Unusable(
            f"{name} is not installed for {sys.executable}: apt install {debian}"
        ) from None


def _line(text: object) -> str:
    """One printable line of what others say."""
    return "".join(c if c.isprintable() else " " for c in str(text)[:200])


def make_qos(passed: dict[str, Any]) -> Any:
    """Best effort hears reliable publishers too; what is latched comes to whoever is late."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    reliable, latched = passed["reliable"], passed["latched"]
    return QoSProfile(
        depth=passed["depth"],
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class FromRos:
    """One topic of ROS, put on Zenoh as it is while somebody hears it there.

    What is latched is always taken, and kept for whoever comes late.

    Args:
        patience_s: how long it may be silent before that is told.

    Attributes:
        wanted: whether somebody is known to hear it.
    """

    def __init__(
        self, ends: Ends, passed: dict[str, Any], kind: Any, patience_s: float = PATIENCE_S
    ) -> None:
        self.wanted = False
        self._node, self._passed, self._kind = ends.node, passed, kind
        self._patience_s, self._due_s, self._heard = patience_s, math.inf, 0
        self._subscription: Any = None
        self._keeps = passed["latched"]
        key, drop = passed["key"], ends.zenoh.CongestionControl.DROP
        if self._keeps:
            ext = import_module("zenoh.ext")
            self._publisher = ext.declare_advanced_publisher(
                ends.session, key, congestion_control=drop,
                cache=ext.CacheConfig(max_samples=_HISTORY), publisher_detection=True,
            )  # fmt: skip
        else:
            self._publisher = ends.session.declare_publisher(key, congestion_control=drop)

    def look(self) -> None:
        """Take it, or let it go, as it is heard; say once why it may be silent."""
        self.wanted = not self._keeps and self._publisher.matching_status
        is_taken, now_s = self._subscription is not None, time.monotonic()
        if is_taken != (self.wanted or self._keeps):
            self._let_go() if is_taken else self._take(now_s)
        elif self._heard == 0 and now_s > self._due_s:
            self._due_s = math.inf
            log.warning("%s: no message yet: %s", self._passed["ros"], self._reason())

    def _take(self, now_s: float) -> None:
        self._heard, self._due_s = 0, now_s + self._patience_s
        self._subscription = self._node.create_subscription(
            self._kind, self._passed["ros"], self._pass, make_qos(self._passed), raw=True
        )

    def _let_go(self) -> None:
        self._node.destroy_subscription(self._subscription)
        self._subscription, self._due_s = None, math.inf

    def _pass(self, message: bytes) -> None:
        self._publisher.put(message)
        self._heard += 1

    def _reason(self) -> str:
        """Most mistakes are names and types."""
        there = self._node.get_publishers_info_by_topic(self._passed["ros"])
        types = sorted({info.topic_type for info in there})
        if not there:
            return "nobody publishes it"
        if types != [self._passed["type"]]:
            return f"it is {_line(', '.join(types))}, not {self._passed['type']}"
        return f"{len(there)} publish it (is their quality of service another?)"


class ToRos:
    """One key of Zenoh, published in ROS as it is; the first that is no message is told."""

    def __init__(self, ends: Ends, passed: dict[str, Any], max_bytes: int) -> None:
        self._key, self._depth, self._max_bytes = passed["key"], passed["depth"], max_bytes
        self._told = False
        ring = ends.zenoh.handlers.RingChannel(self._depth)
        self._arriving = ends.session.declare_subscriber(self._key, ring)
        self._publisher = ends.node.create_publisher(
            find_type(passed["type"]), passed["ros"], make_qos(passed)
        )

    def look(self) -> None:
        for _ in range(self._depth):
            sample = self._arriving.try_recv()
            if sample is None:
                return
            try:
                self._publisher.publish(_cdr_of(sample.payload, self._max_bytes))
            except ValueError as error:
                if not self._told:
                    self._told = True
                    log.warning("%s: left out: %s (further ones are not told)", self._key, error)


def _cdr_of(payload: Any, max_bytes: int) -> bytes:
    """What is given to ROS, which does not look; raises ValueError where it is none."""
    if payload is None or len(payload) > max_bytes:
        size = 0 if payload is None else len(payload)
        raise ValueError(f"{size} bytes, at most {max_bytes} are taken")
    data = payload.to_bytes()
    if data[:2] != _CDR:
        raise ValueError(f"not little-endian CDR: begins {data[:4].hex() or 'empty'}")
    return data


class Service:
    """One service of ROS, offered on Zenoh as long as somebody serves it.

    Args:
        answered: called with each request and its answer.
    """

    def __init__(
        self, ends: Ends, place: dict[str, str], kind: Any, answered: Callable[[Any, Any], None]
    ) -> None:
        self._ends, self._key, self._kind, self._answered = ends, place["key"], kind, answered
        self._client = ends.node.create_client(kind, place["ros"])
        self._queries: Any = None
        self._waiting: dict[Any, Any] = {}  # future: query

    def look(self) -> None:
        """Offer it, or no more; who waits for an answer then waits no longer."""
        if self._client.service_is_ready():
            if self._queries is None:
                ring = self._ends.zenoh.handlers.RingChannel(_KEPT)
                self._queries = self._ends.session.declare_queryable(self._key, ring, complete=True)
        elif self._queries is not None:
            self._queries.undeclare()
            self._queries = None
            for future, query in self._waiting.items():
                self._client.remove_pending_request(future)
                query.drop()
            self._waiting.clear()

    def pass_requests(self) -> None:
        """At most as many as the ring holds."""
        for _ in range(_KEPT):
            query = None if self._queries is None else self._queries.try_recv()
            if query is None:
                return
            self._pass(query)

    def ask(self, request: Any) -> None:
        """Send a request of our own, whose answer nobody waits for."""
        self._client.call_async(request)

    def _pass(self, query: Any) -> None:
        from rclpy.serialization import deserialize_message

        try:
            payload = _cdr_of(query.payload, _REQUEST_BYTES)
            request = deserialize_message(payload, self._kind.Request)
        except Exception as error:  # rclpy raises what its middleware does
            log.warning("%s: a request is left out: %s", self._key, _line(error))
            query.drop()
            return
        future = self._client.call_async(request)
        self._waiting[future] = query
        future.add_done_callback(lambda done: self._answer(request, done))

    def _answer(self, request: Any, done: Any) -> None:
        from rclpy.serialization import serialize_message

        query = self._waiting.pop(done, None)
        if query is not None and not done.cancelled():
            query.reply(query.key_expr, serialize_message(done.result()))
            query.drop()
            self._answered(request, done.result())


class Action:
    """NavigateToPose, passed: three services and two topics.

    The goal that was accepted last is cancelled where nobody follows any more what becomes of it.
    """

    def __init__(self, ends: Ends, plan: dict[str, str]) -> None:
        impl = find_type(plan["type"]).Impl

        def place(name: str) -> dict[str, Any]:
            return {key: f"{plan[key]}/_action/{name}" for key in ("ros", "key")}

        def service(name: str, kind: Any, answered: Callable[[Any, Any], None]) -> Service:
            return Service(ends, place(name), kind, answered)

        def topic(name: str, kind: Any) -> FromRos:
            quality = {"reliable": True, "latched": False, "depth": 10}
            return FromRos(ends, {**place(name), **quality}, kind, patience_s=math.inf)

        self._cancel_goal = impl.CancelGoalService
        self._send = service("send_goal", impl.SendGoalService, self._on_accepted)
        self._result = service("get_result", impl.GetResultService, self._on_result)
        self._cancel = service("cancel_goal", impl.CancelGoalService, lambda *_: None)
        self._services = self._send, self._result, self._cancel
        self._topics = [
            topic("feedback", impl.FeedbackMessage), topic("status", impl.GoalStatusMessage)
        ]  # fmt: skip
        self._goal_id: Any = None  # of the goal that was accepted last and has not ended
        self._followed_s = time.monotonic()

    def pass_requests(self) -> None:
        for one in self._services:
            one.pass_requests()

    def look(self, is_followed: bool) -> None:
        """See who is there; `is_followed`: whether the service hears the robot's sensors."""
        for one in (*self._services, *self._topics):
            one.look()
        if is_followed:
            self._followed_s = time.monotonic()
        elif time.monotonic() - self._followed_s > GONE_S and self.cancel():
            log.warning("the service is gone: its goal is cancelled")

    def cancel(self) -> bool:
        """Cancel what the robot drives to for us; whether there was anything."""
        goal_id, self._goal_id = self._goal_id, None
        if goal_id is None:
            return False
        request = self._cancel_goal.Request()
        request.goal_info.goal_id = goal_id
        self._cancel.ask(request)
        return True

    def _on_accepted(self, request: Any, answer: Any) -> None:
        if answer.accepted:
            self._goal_id = request.goal_id

    def _on_result(self, request: Any, answer: Any) -> None:
        if request.goal_id == self._goal_id:
            self._goal_id = None


if __name__ == "__main__":
    sys.exit(main())
