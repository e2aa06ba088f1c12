"""The last few messages of one sensor, waiting to be joined with those of the others."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from edge.bus.topics import Topic
from edge.sources.odometry import StampGuard

KEPT = 4


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message, not yet decoded but for its stamp; `arrived_ns` is on the source's clock."""

    topic: Topic
    stamp_ns: int
    arrived_ns: int
    payload: bytes


class Stream:
    """Messages in the order of their stamps.

    Args:
        tolerance_ns: how far a message's stamp may be from the instant it is asked for.
        required: whether there is no observation without it.
    """

    def __init__(self, tolerance_ns: int, required: bool) -> None:
        self.required = required
        self._tolerance_ns = tolerance_ns
        self._messages: deque[Message] = deque()
        self._guard = StampGuard()

    def offer(self, message: Message) -> str:
        """Take a message; why it was not taken, or why an older one was let go, or ""."""
        verdict = self._guard.judge(message.stamp_ns)
        if verdict in ("repeated", "backward"):
            return verdict
        if verdict == "clock_reset":
            self._messages.clear()
            self._messages.append(message)
            return verdict
        self._messages.append(message)
        if len(self._messages) > KEPT:
            self._messages.popleft()
            return "superseded"
        return ""

    def newest_first(self) -> list[Message]:
        return list(reversed(self._messages))

    def near(self, stamp_ns: int) -> Message | None:
        """The message nearest to an instant, within the tolerance."""
        best = min(self._messages, key=lambda m: abs(m.stamp_ns - stamp_ns), default=None)
        if best is None or abs(best.stamp_ns - stamp_ns) > self._tolerance_ns:
            return None
        return best

    def is_past(self, stamp_ns: int) -> bool:
        """Whether every message still to come is too late for this instant."""
        newest_ns = self._guard.newest_ns
        return newest_ns is not None and newest_ns > stamp_ns + self._tolerance_ns

    def drop(self, message: Message) -> None:
        self._messages.remove(message)

    def drop_through(self, stamp_ns: int) -> int:
        """Let go of everything up to an instant; how many they were."""
        n = 0
        while self._messages and self._messages[0].stamp_ns <= stamp_ns:
            self._messages.popleft()
            n += 1
        return n
