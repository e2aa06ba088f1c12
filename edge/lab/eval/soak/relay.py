"""Relay of `edge soak`: passes on the robot's sensor messages to the service, or alters them.

The robot's simulator connects only to this process. A `MessageFilter` turns each message into its
replacements, and passes on all other messages unchanged. At most one filter is set at a time.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.session import declare_publisher, zenoh_session
from edge.bus.topics import Topic
from edge.bus.wire import messages
from edge.bus.wire.cdr import HEADER, STAMP
from edge.config import ZenohConfig

MessageFilter = Callable[[Topic, bytes], Sequence[bytes]]
"""Returns the messages that replace a message of a topic. It is called on Zenoh's threads."""

_IMAGES = (topics.RGB, topics.DEPTH, topics.SEGMENTATION)
# PLAYED are the topics that the robot or its simulator publishes.
_STAMPED = tuple(topic for topic in topics.PLAYED if topic.type != "json")


class Relay:
    """Passes on messages until it is closed.

    It listens at the endpoint of `robot`, to which the simulator connects, and connects to that of
    `service`, or its router. `stop` ends a wait for the latter.

    Attributes:
        alter: alters the sensors' messages; None: no change.
        offset_m: added to the x of the odometry, before `alter`.

    Raises:
        Stopped: `stop` was set before the service's endpoint answered.
    """

    def __init__(self, robot: ZenohConfig, service: ZenohConfig, stop: threading.Event) -> None:
        self.alter: MessageFilter | None = None
        self.offset_m = 0.0
        self._delay_s = 0.0
        self._delayed: deque[tuple[float, Topic, bytes]] = deque()
        self._robot, self._service, self._stop = robot, service, stop
        self._robot_side = ExitStack()
        robot_session = self._robot_side.enter_context(zenoh_session(robot, "listen", stop))
        command = declare_publisher(robot_session, topics.CMD_VEL, robot)
        self._put_command = partial(_put, command)
        for topic in topics.PLAYED:
            robot_session.declare_subscriber(robot.key(topic.key), partial(self._pass_on, topic))
        self._publishers: dict[Topic, zenoh.Publisher] = {}
        self._service_side = ExitStack()
        self.connect()

    def connect(self) -> None:
        """Open the session with the service, if there is none."""
        if self._publishers:
            return
        session = self._service_side.enter_context(
            zenoh_session(self._service, "connect", self._stop)
        )
        key = self._service.key(topics.CMD_VEL.key)
        session.declare_subscriber(key, lambda sample: self._put_command(sample.payload.to_bytes()))
        self._publishers = {
            topic: declare_publisher(session, topic, self._service) for topic in topics.PLAYED
        }

    def cut(self) -> None:
        """Close the session with the service. Messages until `connect` are lost."""
        self._publishers = {}
        self._service_side.close()

    def close(self) -> None:
        """Close both sessions."""
        self.cut()
        self._robot_side.close()

    def delay(self, delay_s: float) -> None:
        """Delay every message from now on; 0: no delay."""
        self._delay_s = delay_s

    def step(self) -> None:
        """Send the messages whose delay is over."""
        now_s = time.monotonic()
        while self._delayed and self._delayed[0][0] <= now_s:
            _, topic, payload = self._delayed.popleft()
            self._send(topic, payload)

    def _pass_on(self, topic: Topic, sample: zenoh.Sample) -> None:
        payload, alter = sample.payload.to_bytes(), self.alter
        if topic is topics.ODOMETRY and self.offset_m:
            payload = moved(payload, self.offset_m)
        for sent in (payload,) if alter is None else alter(topic, payload):
            if self._delay_s:
                self._delayed.append((time.monotonic() + self._delay_s, topic, sent))
            else:
                self._send(topic, sent)

    def _send(self, topic: Topic, payload: bytes) -> None:
        if (publisher := self._publishers.get(topic)) is not None:
            _put(publisher, payload)


def _put(publisher: zenoh.Publisher, payload: bytes) -> None:
    try:
        publisher.put(payload)
    except zenoh.ZError:  # its session is being closed
        return


# -- altered messages ------------------------------------------------------------------------------


def moved(payload: bytes, x_m: float, yaw_rad: float = 0.0) -> bytes:
    """Return odometry that is rotated about the origin of `map`, then moved along x."""
    odometry = messages.decode_odometry(payload)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    T = np.array([[c, -s, 0, x_m], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    return messages.encode_odometry(
        odometry.stamp_ns, T @ odometry.T_map_base, odometry.v_mps, odometry.w_radps
    )


def restamped(payload: bytes, stamp_ns: int) -> bytes:
    """Return a message that begins with a header, with another stamp."""
    begin, end = len(HEADER), len(HEADER) + STAMP.size  # bytes of the stamp: (s, ns)
    return payload[:begin] + STAMP.pack(*divmod(stamp_ns, 1_000_000_000)) + payload[end:]


def drop(only: Sequence[Topic]) -> MessageFilter:
    """Return a `MessageFilter` that drops messages of these topics."""
    return lambda topic, payload: () if topic in only else (payload,)


def freeze(stamps_go_on: bool) -> MessageFilter:
    """Return a `MessageFilter` that repeats each topic's first image, like a driver that hangs."""
    first: dict[Topic, bytes] = {}

    def alter(topic: Topic, payload: bytes) -> Sequence[bytes]:
        if topic not in _IMAGES:
            return (payload,)
        image = first.setdefault(topic, payload)
        return (restamped(image, messages.peek_stamp_ns(payload)) if stamps_go_on else image,)

    return alter


def shift_stamps(ahead_s: float) -> MessageFilter:
    """Return a `MessageFilter` that moves all stamps ahead."""

    def alter(topic: Topic, payload: bytes) -> Sequence[bytes]:
        if topic not in _STAMPED:
            return (payload,)
        return (restamped(payload, messages.peek_stamp_ns(payload) + int(1e9 * ahead_s)),)

    return alter


def move_odometry(x_m: float, yaw_rad: float) -> MessageFilter:
    """Return a `MessageFilter` that moves the odometry, as after a jump of the pose."""
    return lambda topic, payload: (
        (moved(payload, x_m, yaw_rad),) if topic is topics.ODOMETRY else (payload,)
    )


def add_garbage(rng: np.random.Generator) -> MessageFilter:
    """Return a `MessageFilter` that sends a malformed message before each message."""
    lock = threading.Lock()  # the generator is not thread-safe, and Zenoh has several threads

    def alter(topic: Topic, payload: bytes) -> Sequence[bytes]:
        with lock:
            return malformed(payload, rng), payload

    return alter


def malformed(payload: bytes, rng: np.random.Generator) -> bytes:
    """Return a malformed message: cut, random, or with changed bytes."""
    kind = rng.integers(3)
    if kind == 0:
        return payload[: rng.integers(len(payload) + 1)]
    if kind == 1:
        return rng.bytes(int(rng.integers(1, 512)))
    content = bytearray(payload)
    for at in rng.integers(0, max(min(len(content), 256), 1), 16 if content else 0):
        content[at] = rng.integers(256)
    return bytes(content)
