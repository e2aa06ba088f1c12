"""Queue of one sensor's newest frames, which wait to be joined with those of other sensors."""

from __future__ import annotations

from bisect import bisect_left

from edge.sources.messages import SensorFrame
from edge.sources.odometry import StampGuard

KEPT = 4
"""Frames that are kept at any age, and that are buffered between two polls of a topic."""
MOST = 64
"""Largest number of frames that are kept, however small they are."""


class Stream:
    """Frames ordered by stamp.

    Args:
        tolerance_ns: largest difference between a frame's stamp and the requested instant.
        required: True if an observation needs this sensor.
        kept_ns: largest age of a frame relative to the newest.
        most_bytes: limit of all frames together.

    Attributes:
        delay_ns: arrival minus stamp of the newest frame; None before the first. The two times are
            of different clocks, so only differences between streams are meaningful.
    """

    def __init__(self, tolerance_ns: int, required: bool, kept_ns: int, most_bytes: int) -> None:
        self.required = required
        self.delay_ns: int | None = None
        self._tolerance_ns, self._kept_ns, self._most_bytes = tolerance_ns, kept_ns, most_bytes
        self._frames: list[SensorFrame] = []
        self._guard = StampGuard()
        self._bytes = 0

    def offer(self, frame: SensorFrame) -> str:
        """Append a frame; return why it was rejected, why an older frame was dropped, or ""."""
        verdict = self._guard.check(frame.stamp_ns)
        if verdict in ("repeated", "backward"):
            return verdict
        self.delay_ns = frame.arrived_ns - frame.stamp_ns
        if verdict == "clock_reset":
            self._frames.clear()
            self._bytes = 0
        self._frames.append(frame)
        self._bytes += frame.size
        n = len(self._frames)
        while self._has_too_many(frame.stamp_ns - self._kept_ns):
            self.drop_frame(self._frames[0])
        if verdict == "clock_reset":
            return verdict
        return "superseded" if len(self._frames) < n else ""

    def _has_too_many(self, oldest_ns: int) -> bool:
        n = len(self._frames)
        if n > MOST or (n > 1 and self._bytes > self._most_bytes):
            return True
        return n > KEPT and self._frames[0].stamp_ns < oldest_ns

    def newest_first(self) -> list[SensorFrame]:
        return self._frames[::-1]

    def find_match(self, stamp_ns: int) -> SensorFrame | None:
        """Return the frame nearest to an instant, within the tolerance, or None."""
        best = self.nearest(stamp_ns)
        if best is None or abs(best.stamp_ns - stamp_ns) > self._tolerance_ns:
            return None
        return best

    def nearest(self, stamp_ns: int) -> SensorFrame | None:
        """Return the frame nearest to an instant at any distance; None if there is none."""
        i = bisect_left(self._frames, stamp_ns, key=lambda f: f.stamp_ns)
        around = self._frames[max(i - 1, 0) : i + 1]
        return min(around, key=lambda f: abs(f.stamp_ns - stamp_ns), default=None)

    def is_past(self, stamp_ns: int) -> bool:
        """Return True if every future frame is too late for this instant."""
        newest_ns = self._guard.newest_ns
        return newest_ns is not None and newest_ns > stamp_ns + self._tolerance_ns

    def drop_frame(self, frame: SensorFrame) -> None:
        self._frames.remove(frame)
        self._bytes -= frame.size

    def drop_through(self, stamp_ns: int) -> int:
        """Drop all frames up to an instant; return their number."""
        n = 0
        while self._frames and self._frames[0].stamp_ns <= stamp_ns:
            self.drop_frame(self._frames[0])
            n += 1
        return n

    def drop_unneeded(self, stamp_ns: int) -> None:
        """Drop frames that no later instant can be joined with, except the newest."""
        while len(self._frames) > 1 and self._frames[0].stamp_ns < stamp_ns - self._tolerance_ns:
            self.drop_frame(self._frames[0])
