"""Passes topics between ROS and Zenoh without decoding them."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, NamedTuple

log = logging.getLogger("edge.ros2_adapter")

PATIENCE_S = 5.0  # before a warning that a topic has no messages
_CDR = b"\x00\x01"  # first bytes of a little-endian payload
_HISTORY = 100  # latched messages kept, from all publishers of a topic


class SetupError(Exception):
    """A fault that a restart cannot repair; the message is one line."""


class AdapterEnds(NamedTuple):
    """The two ends of the adapter: a ROS node and a Zenoh session.

    Attributes:
        zenoh: the imported module `zenoh`.
        wake: makes the node's thread check its queues now; any thread may call it.
    """

    node: Any
    session: Any
    zenoh: Any
    wake: Callable[[], None]


class Inbox:
    """A queue from Zenoh's threads to the node's thread; if it is full, the oldest item is dropped.

    Args:
        capacity: largest number of items.
        wake: see `AdapterEnds`.
    """

    def __init__(self, capacity: int, wake: Callable[[], None]) -> None:
        self._waiting: deque[Any] = deque(maxlen=capacity)
        self._capacity, self._wake = capacity, wake

    def __call__(self, item: Any) -> None:
        self._waiting.append(item)
        self._wake()

    def take(self) -> Iterator[Any]:
        """Yield the items since the last call, at most `capacity`, oldest first."""
        for _ in range(self._capacity):
            try:
                yield self._waiting.popleft()
            except IndexError:
                return


def find_type(name: str) -> Any:
    """Return the class of `package/msg/Name` or `package/action/Name`.

    Raises:
        SetupError: it is not installed.
    """
    package, kind, cls = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), cls)
    except (ImportError, AttributeError):
        debian = f"ros-{os.environ.get('ROS_DISTRO', '$ROS_DISTRO')}-{package.replace('_', '-')}"
        raise SetupError(
            f"{name} is not installed for {sys.executable}: apt install {debian}"
        ) from None


def one_line(text: object) -> str:
    """Return a text from outside as one printable line."""
    return "".join(c if c.isprintable() else " " for c in str(text)[:200])


def make_qos(topic_plan: dict[str, Any]) -> Any:
    """Return the quality of service of a topic of the plan.

    Best effort receives from reliable publishers too. `latched` is ROS 2's transient local.
    """
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    reliable, latched = topic_plan["reliable"], topic_plan["latched"]
    return QoSProfile(
        depth=topic_plan["depth"],
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def make_callbacks(topic_plan: dict[str, Any]) -> Any:
    """Return rclpy's event callbacks; None: its own.

    Its own warn of each publisher with another quality of service. `stop` is subscribed with each.
    """
    if not topic_plan["on_events"]:
        return None
    try:
        from rclpy.event_handler import SubscriptionEventCallbacks
    except ImportError:  # Humble
        from rclpy.qos_event import SubscriptionEventCallbacks
    return SubscriptionEventCallbacks(use_default_callbacks=False)


class FromRos:
    """A ROS topic, passed to Zenoh while there is a subscriber on Zenoh.

    A latched topic is always subscribed, and kept for late subscribers. A topic of events is not:
    each new subscription gets what its publishers hold then, and not a stop that they took back.

    Args:
        ends: node and session.
        topic_plan: entry of the topic in the plan: names, type and quality of service.
        kind: the message class.

    Attributes:
        wanted: True if there is a subscriber on Zenoh; always False for a topic that is kept.
    """

    def __init__(self, ends: AdapterEnds, topic_plan: dict[str, Any], kind: Any) -> None:
        self.wanted = False
        self._node, self._plan, self._kind = ends.node, topic_plan, kind
        self._patience_s = math.inf if topic_plan["on_events"] else PATIENCE_S
        self._due_s, self._received = math.inf, 0
        self._subscription: Any = None
        self._latched = topic_plan["latched"] and not topic_plan["on_events"]
        key, drop = topic_plan["key"], ends.zenoh.CongestionControl.DROP
        if self._latched:
            ext = import_module("zenoh.ext")
            self._publisher = ext.declare_advanced_publisher(
                ends.session, key, congestion_control=drop,
                cache=ext.CacheConfig(max_samples=_HISTORY), publisher_detection=True,
            )  # fmt: skip
        else:
            self._publisher = ends.session.declare_publisher(key, congestion_control=drop)

    def update(self) -> None:
        """Subscribe or unsubscribe as needed; log once why a topic may be silent."""
        self.wanted = not self._latched and self._publisher.matching_status.matching
        is_subscribed, now_s = self._subscription is not None, time.monotonic()
        if is_subscribed != (self.wanted or self._latched):
            if is_subscribed:
                self._unsubscribe()
            else:
                self._subscribe(now_s)
        elif self._received == 0 and now_s > self._due_s:
            self._due_s = math.inf
            log.warning("%s: no message yet: %s", self._plan["ros"], self._reason())

    def _subscribe(self, now_s: float) -> None:
        self._received, self._due_s = 0, now_s + self._patience_s
        self._subscription = self._node.create_subscription(
            self._kind, self._plan["ros"], self._forward, make_qos(self._plan), raw=True,
            event_callbacks=make_callbacks(self._plan),
        )  # fmt: skip

    def _unsubscribe(self) -> None:
        self._node.destroy_subscription(self._subscription)
        self._subscription, self._due_s = None, math.inf

    def _forward(self, message: bytes) -> None:
        self._publisher.put(message)
        self._received += 1

    def _reason(self) -> str:
        """Return the likely reason of silence: mostly a wrong name or type."""
        publishers = self._node.get_publishers_info_by_topic(self._plan["ros"])
        types = sorted({info.topic_type for info in publishers})
        if not publishers:
            return "it has no publisher"
        if types != [self._plan["type"]]:
            return f"it is {one_line(', '.join(types))}, not {self._plan['type']}"
        return f"{len(publishers)} publishers; check that their quality of service matches"


class ToRos:
    """A Zenoh key, published as a ROS topic; the first invalid message is logged."""

    def __init__(self, ends: AdapterEnds, topic_plan: dict[str, Any], max_bytes: int) -> None:
        self._key, self._max_bytes, self._warned = topic_plan["key"], max_bytes, False
        self._inbox = Inbox(topic_plan["depth"], ends.wake)
        self._subscriber = ends.session.declare_subscriber(self._key, self._inbox)
        self._publisher = ends.node.create_publisher(
            find_type(topic_plan["type"]), topic_plan["ros"], make_qos(topic_plan)
        )

    def update(self) -> None:
        """Publish the messages that came since the last call."""
        for sample in self._inbox.take():
            try:
                self._publisher.publish(cdr_of(sample.payload, self._max_bytes))
            except ValueError as error:
                if not self._warned:
                    self._warned = True
                    log.warning(
                        "%s: message dropped: %s (further ones are not logged)", self._key, error
                    )


def cdr_of(zbytes: Any, max_bytes: int) -> bytes:
    """Return a Zenoh payload for ROS, which does not check it; raise ValueError if it is no CDR."""
    if zbytes is None or len(zbytes) > max_bytes:
        size = 0 if zbytes is None else len(zbytes)
        raise ValueError(f"the message has {size} bytes, at most {max_bytes} are allowed")
    data = zbytes.to_bytes()
    if data[:2] != _CDR:
        begin = data[:4].hex() or "nothing"
        raise ValueError(f"not little-endian CDR: the message begins with {begin}, expected 0001")
    return data
