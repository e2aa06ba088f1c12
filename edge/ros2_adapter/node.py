"""The adapter's node, run as a file by the robot's own ROS Python: rclpy, zenoh, no `edge`.

`python3 node.py` reads its plan, one line of JSON (see `edge.ros2_adapter.process`), from standard
input, and ends when that is closed. Messages are passed as the bytes that they are; only goals are
opened, since the action wants them so.

One thread does everything: Zenoh's messages are looked for between two callbacks of ROS.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import struct
import sys
import threading
import time
from collections import deque
from importlib import import_module
from typing import Any

log = logging.getLogger("edge.ros2_adapter")

LOOK_S = 0.005  # between two looks at what Zenoh brought
PATIENCE_S = 5.0  # for a first message, and for the action to accept or reject a goal
GONE_S = 3.0  # without a goal's repetition: nobody looks where the robot goes
REPLACED_S = 0.5  # what drives to one goal at a time has let go of the one before by then
FEEDBACK_S = 1.0
SETTLE_S = 0.5
_OPEN_AGAIN_S = 0.5
_CDR = b"\x00\x01"
_STAMP = struct.Struct("<iI")
_KEPT = 64

# action_msgs/GoalStatus
_SUCCEEDED, _CANCELED, _ABORTED = 4, 5, 6


class Unusable(Exception):
    """Something that no restart mends; one line."""


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
        inward = [FromRos(node, zenoh, session, passed) for passed in plan["sensors"]]
        looks = [ToRos(node, zenoh, session, passed).look for passed in plan["results"]]
        looks += [FirstMessages(node, inward).look]
        navigator = None
        if plan["goals"] is not None:
            navigator = Navigator(node, zenoh, session, plan["goals"])
            looks.append(navigator.look)
        log.info("passes %d topics in and %d out", len(inward), len(plan["results"]))
        while not stop.is_set():
            executor.spin_once(timeout_sec=LOOK_S)
            for look in looks:
                look()
        if navigator is not None and navigator.leave():
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
            "rclpy": "source ROS 2's setup file first, or name it in ros2_adapter.setup",
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
    """One topic of ROS, put on Zenoh as it is.

    Attributes:
        heard: how many messages came.
    """

    def __init__(self, node: Any, zenoh: Any, session: Any, passed: dict[str, Any]) -> None:
        self.heard = 0
        self.topic, self.type = passed["ros"], passed["type"]
        self._publisher = session.declare_publisher(
            passed["key"], congestion_control=zenoh.CongestionControl.DROP
        )
        kind, qos = find_type(passed["type"]), make_qos(passed)
        node.create_subscription(kind, passed["ros"], self._pass, qos, raw=True)

    def _pass(self, message: bytes) -> None:
        self._publisher.put(message)
        self.heard += 1


class FirstMessages:
    """Says once of every silent topic why that may be: most mistakes are names and types."""

    def __init__(self, node: Any, topics: list[FromRos]) -> None:
        self._node, self._topics = node, topics
        self._due_s = time.monotonic() + PATIENCE_S

    def look(self) -> None:
        if not self._topics or time.monotonic() < self._due_s:
            return
        for topic in self._topics:
            if topic.heard == 0:
                log.warning("%s: no message yet: %s", topic.topic, self._reason(topic))
        self._topics = []

    def _reason(self, topic: FromRos) -> str:
        there = self._node.get_publishers_info_by_topic(topic.topic)
        types = sorted({info.topic_type for info in there})
        if not there:
            return "nobody publishes it"
        if types != [topic.type]:
            return f"it is {_line(', '.join(types))}, not {topic.type}"
        return f"{len(there)} publish it (is their quality of service another?)"


class Inbox:
    """The newest payloads of one key, at most `kept` a look; what is no CDR is told once."""

    def __init__(self, zenoh: Any, session: Any, key: str, kept: int, max_bytes: int) -> None:
        self._key, self._kept, self._max_bytes = key, kept, max_bytes
        self._told = False
        self._ring = session.declare_subscriber(key, zenoh.handlers.RingChannel(kept))

    def take(self) -> list[bytes]:
        payloads = []
        for _ in range(self._kept):
            sample = self._ring.try_recv()
            if sample is None:
                break
            if len(sample.payload) > self._max_bytes:
                self.refuse(f"{len(sample.payload)} bytes, at most {self._max_bytes} are taken")
                continue
            payload = sample.payload.to_bytes()
            if payload[:2] == _CDR:
                payloads.append(payload)
            else:
                self.refuse(f"not little-endian CDR: begins {payload[:4].hex() or 'empty'}")
        return payloads

    def refuse(self, reason: str) -> None:
        if not self._told:
            self._told = True
            log.warning("%s: left out: %s (further ones are not told)", self._key, reason)


class ToRos:
    """One key of Zenoh, published in ROS as it is."""

    def __init__(self, node: Any, zenoh: Any, session: Any, passed: dict[str, Any]) -> None:
        self._inbox = Inbox(zenoh, session, passed["key"], passed["depth"], passed["max_bytes"])
        self._publisher = node.create_publisher(
            find_type(passed["type"]), passed["ros"], make_qos(passed)
        )

    def look(self) -> None:
        for payload in self._inbox.take():
            self._publisher.publish(payload)


class Errand:
    """One goal of the service on its way through the action.

    Attributes:
        stamp_ns: what the service knows it by.
        payload: the goal as it came.
        sent_s: when it was given to the action; None: it is to be.
        handle: the action's, once accepted.
        answer: what the service was told last.
        over: whether the action is done with it.
    """

    def __init__(self, stamp_ns: int, payload: bytes) -> None:
        self.stamp_ns, self.payload = stamp_ns, payload
        self.sent_s: float | None = None
        self.handle: Any = None
        self.answer: dict[str, Any] | None = None
        self.over = False


class Navigator:
    """Gives goals to the action NavigateToPose, and its answers to the service.

    A newer goal takes the place of the one before, as Nav2 has it; a server that goes on driving
    to the old one is told to cancel that. A goal that the service no longer repeats is cancelled.
    """

    def __init__(self, node: Any, zenoh: Any, session: Any, plan: dict[str, Any]) -> None:
        from geometry_msgs.msg import PoseStamped
        from rclpy.action import ActionClient
        from rclpy.serialization import deserialize_message

        self._name, self._action = plan["action"], find_type(plan["type"])
        self._read = lambda payload: deserialize_message(payload, PoseStamped)
        self._client = ActionClient(node, self._action, self._name)
        self._inbox = Inbox(zenoh, session, plan["key"], 8, plan["max_bytes"])
        self._answers = session.declare_publisher(
            plan["answer_key"], congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH, express=True,
        )  # fmt: skip
        self._present: Errand | None = None
        self._heard_s = 0.0
        self._told_s = 0.0
        self._replaced: deque[int] = deque(maxlen=_KEPT)
        self._leaving: list[tuple[float, Errand]] = []  # when to cancel, what
        self._waiting_told = False

    def look(self) -> None:
        """Take goals, and do what time has come for; never blocks."""
        now_s = time.monotonic()
        for payload in self._inbox.take():
            self._take(payload, now_s)
        errand = self._present
        if errand is not None and not errand.over:
            self._follow(errand, now_s)
        if self._leaving:
            self._leaving = [kept for kept in self._leaving if not self._left(*kept, now_s)]

    def leave(self) -> bool:
        """Cancel what the robot drives to; whether there was anything."""
        errand, self._present = self._present, None
        if errand is None or errand.over or errand.sent_s is None:
            return False
        self._cancel(errand)
        return True

    def _take(self, payload: bytes, now_s: float) -> None:
        if len(payload) < 4 + _STAMP.size:
            self._inbox.refuse(f"{len(payload)} bytes are no PoseStamped")
            return
        seconds, nanoseconds = _STAMP.unpack_from(payload, 4)
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        if stamp_ns in self._replaced:
            return
        self._heard_s = now_s
        before = self._present
        if before is not None and before.stamp_ns == stamp_ns:
            if before.answer is not None:  # it is repeated: the answer may have been lost
                self._send_answer(before.answer)
            return
        if before is not None:
            self._replaced.append(before.stamp_ns)
            if not before.over and before.sent_s is not None:
                self._leaving.append((now_s + REPLACED_S, before))
        self._present = Errand(stamp_ns, payload)

    def _follow(self, errand: Errand, now_s: float) -> None:
        """Send it, as soon as there is a server; see whether both ends are still there."""
        if now_s - self._heard_s > GONE_S:
            log.warning("the service repeats its goal no more: the goal is cancelled")
            self.leave()
        elif errand.sent_s is None:
            self._send(errand, now_s)
        elif errand.handle is None and now_s - errand.sent_s > PATIENCE_S:
            self._end(errand, "failed", f"{self._name} neither accepted nor rejected it")
        elif errand.handle is not None and not self._client.server_is_ready():
            self._end(errand, "failed", f"{self._name} is gone")

    def _send(self, errand: Errand, now_s: float) -> None:
        if not self._client.server_is_ready():
            if not self._waiting_told:
                self._waiting_told = True
                log.warning("waiting for the action %s: is Nav2 running?", self._name)
            return
        try:
            pose = self._read(errand.payload)
        except Exception as error:  # rclpy raises what its middleware does
            self._end(errand, "failed", f"the adapter cannot read it: {_line(error)}")
            return
        goal = self._action.Goal()
        goal.pose = pose
        errand.sent_s = now_s
        future = self._client.send_goal_async(goal, lambda said: self._on_way(errand, said))
        future.add_done_callback(lambda done: self._on_response(errand, done.result()))

    def _on_response(self, errand: Errand, handle: Any) -> None:
        if not handle.accepted:
            self._end(errand, "failed", f"rejected by {self._name}")
            return
        errand.handle = handle
        if errand is self._present and not errand.over:
            self._answer(errand, "accepted", "")
        elif not any(errand is other for _, other in self._leaving):
            self._cancel(errand)
        future = handle.get_result_async()
        future.add_done_callback(lambda done: self._on_result(errand, done.result()))

    def _on_way(self, errand: Errand, said: Any) -> None:
        now_s = time.monotonic()
        if errand is not self._present or errand.handle is None or errand.over:
            return
        if now_s - self._told_s < FEEDBACK_S:
            return
        self._told_s = now_s
        feedback = said.feedback
        reason = f"{feedback.distance_remaining:.1f} m to go"
        if feedback.number_of_recoveries:
            reason += f", {feedback.number_of_recoveries} recoveries"
        self._answer(errand, "accepted", reason)

    def _on_result(self, errand: Errand, result: Any) -> None:
        if result.status == _SUCCEEDED:
            self._end(errand, "reached", "")
            return
        how = {_ABORTED: "aborted", _CANCELED: "cancelled"}.get(result.status, "lost")
        # Which of the two there are depends on the distribution.
        said = getattr(result.result, "error_msg", "") or ""
        code = getattr(result.result, "error_code", 0)
        detail = said or (f"error {code}" if code else "")
        self._end(errand, "failed", f"{how} by {self._name}" + (f": {detail}" if detail else ""))

    def _end(self, errand: Errand, state: str, reason: str) -> None:
        if errand.over:
            return
        errand.over = True
        if errand is self._present:
            self._answer(errand, state, reason)

    def _left(self, due_s: float, errand: Errand, now_s: float) -> bool:
        """Whether nothing is to be done about a replaced goal any more."""
        if errand.over:
            return True
        if now_s < due_s:
            return False
        self._cancel(errand)
        return True

    def _cancel(self, errand: Errand) -> None:
        """One that is not accepted yet is cancelled when it is."""
        if errand.handle is not None:
            errand.handle.cancel_goal_async()

    def _answer(self, errand: Errand, state: str, reason: str) -> None:
        errand.answer = {"stamp": errand.stamp_ns, "state": state, "reason": reason}
        self._send_answer(errand.answer)

    def _send_answer(self, answer: dict[str, Any]) -> None:
        self._answers.put(json.dumps(answer).encode())


if __name__ == "__main__":
    sys.exit(main())
