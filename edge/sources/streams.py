"""The last few frames of one sensor, waiting to be joined with those of the others."""

from __future__ import annotations

from collections import deque

from edge.sources.messages import Frame
from edge.sources.odometry import StampGuard

KEPT = 4


class Stream:
    """Frames in the order of their stamps.

    Args:
        tolerance_ns: how far a frame's stamp may be from the instant it is asked for.
        required: whether there is no observation without it.
    """

    def __init__(self, tolerance_ns: int, required: bool) -> None:
        self.required = required
        self._tolerance_ns = tolerance_ns
        self._frames: deque[Frame] = deque()
        self._guard = StampGuard()

    def offer(self, frame: Frame) -> str:
        """Take a frame; why it was not taken, or why an older one was let go, or ""."""
        verdict = self._guard.judge(frame.stamp_ns)
        if verdict in ("repeated", "backward"):
            return verdict
        if verdict == "clock_reset":
            self._frames.clear()
            self._frames.append(frame)
            return verdict
        self._frames.append(frame)
        if len(self._frames) > KEPT:
            self._frames.popleft()
            return "superseded"
        return ""

    def newest_first(self) -> list[Frame]:
        return list(reversed(self._frames))

    def near(self, stamp_ns: int) -> Frame | None:
        """The frame nearest to an instant, within the tolerance."""
        best = self.nearest(stamp_ns)
        if best is None or abs(best.stamp_ns - stamp_ns) > self._tolerance_ns:
            return None
        return best

    def nearest(self, stamp_ns: int) -> Frame | None:
        """Return the frame nearest to an instant, however far; None: there is none."""
        return min(self._frames, key=lambda f: abs(f.stamp_ns - stamp_ns), default=None)

    def is_past(self, stamp_ns: int) -> bool:
        """Whether every frame still to come is too late for this instant."""
        newest_ns = self._guard.newest_ns
        return newest_ns is not None and newest_ns > stamp_ns + self._tolerance_ns

    def drop(self, frame: Frame) -> None:
        self._frames.remove(frame)

    def drop_through(self, stamp_ns: int) -> int:
        """Let go of everything up to an instant; how many they were."""
        n = 0
        while self._frames and self._frames[0].stamp_ns <= stamp_ns:
            self._frames.popleft()
            n += 1
        return n
