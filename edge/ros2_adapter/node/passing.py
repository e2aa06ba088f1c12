"""Topics, passed between ROS and Zenoh as they are."""

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

PATIENCE_S = 5.0  # for a first message
_CDR = b"\x00\x01"
_HISTORY = 100  # latched messages, of all publishers of a topic


class Unusable(Exception):
    """Something that no restart mends; one line."""


class Ends(NamedTuple):
    """Where messages are passed between: a node of ROS and a session of Zenoh, and its package.

    `wake` has the node's thread look at once; any thread may call it.
    """

    node: Any
    session: Any
    zenoh: Any
    wake: Callable[[], None]


class Inbox:
    """The newest of what Zenoh brings, on threads of its own, for the node's thread."""

    def __init__(self, kept: int, wake: Callable[[], None]) -> None:
        self._waiting: deque[Any] = deque(maxlen=kept)
        self._kept, self._wake = kept, wake

    def __call__(self, item: Any) -> None:
        self._waiting.append(item)
        self._wake()

    def take(self) -> Iterator[Any]:
        """What came since the last look, `kept` at most, oldest first."""
        for _ in range(self._kept):
            try:
                yield self._waiting.popleft()
            except IndexError:
                return


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


def one_line(text: object) -> str:
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
        self.wanted = not self._keeps and self._publisher.matching_status.matching
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
            return f"it is {one_line(', '.join(types))}, not {self._passed['type']}"
        return f"{len(there)} publish it (is their quality of service another?)"


class ToRos:
    """One key of Zenoh, published in ROS as it is; the first that is no message is told."""

    def __init__(self, ends: Ends, passed: dict[str, Any], max_bytes: int) -> None:
        self._key, self._max_bytes, self._told = passed["key"], max_bytes, False
        self._inbox = Inbox(passed["depth"], ends.wake)
        self._subscriber = ends.session.declare_subscriber(self._key, self._inbox)
        self._publisher = ends.node.create_publisher(
            find_type(passed["type"]), passed["ros"], make_qos(passed)
        )

    def look(self) -> None:
        for sample in self._inbox.take():
            try:
                self._publisher.publish(cdr_of(sample.payload, self._max_bytes))
            except ValueError as error:
                if not self._told:
                    self._told = True
                    log.warning("%s: left out: %s (further ones are not told)", self._key, error)


def cdr_of(brought: Any, max_bytes: int) -> bytes:
    """What is given to ROS, which does not look; raises ValueError where it is none."""
    if brought is None or len(brought) > max_bytes:
        size = 0 if brought is None else len(brought)
        raise ValueError(f"{size} bytes, at most {max_bytes} are taken")
    data = brought.to_bytes()
    if data[:2] != _CDR:
        raise ValueError(f"not little-endian CDR: begins {data[:4].hex() or 'empty'}")
    return data
