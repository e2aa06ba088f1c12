"""One line that says how the run stands: rewritten on a terminal, printed now and then in a log."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import TextIO

from edge.logs import CLEAR_LINE

TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0


@dataclass(frozen=True, slots=True)
class Progress:
    """What the line shows.

    Attributes:
        phase: the mission's (see `edge.types.MissionPhase`), or what is waited for.
        goal_kind: `frontier`, `instance`, or None when there is no goal.
        goal_distance_m: from the robot to the goal's candidate.
        instances: things of the target's label in the map.
        map_m2: area that is known.
        tick_p95_ms, detector_ms: None before the first.
    """

    phase: str
    target: str
    elapsed_s: float = 0.0
    goal_kind: str | None = None
    goal_distance_m: float = 0.0
    instances: int = 0
    map_m2: float = 0.0
    tick_p95_ms: float | None = None
    detector_ms: float | None = None


def format_line(progress: Progress) -> str:
    """The line, without control characters.

    >>> format_line(Progress("searching", "chair", 12.34, "frontier", 2.5, 1, 40.2, 1.93, 9.1))
    '12.3s searching chair | frontier 2.5 m | 1 seen | map 40 m2 | tick p95 1.9 ms | detector 9 ms'
    """
    goal = f"{progress.goal_kind} {progress.goal_distance_m:.1f} m" if progress.goal_kind else None
    parts = [
        f"{progress.elapsed_s:.1f}s {progress.phase} {progress.target}",
        goal or "no goal",
        f"{progress.instances} seen",
        f"map {progress.map_m2:.0f} m2",
    ]
    if progress.tick_p95_ms is not None:
        parts.append(f"tick p95 {progress.tick_p95_ms:.1f} ms")
    if progress.detector_ms is not None:
        parts.append(f"detector {progress.detector_ms:.0f} ms")
    return "".join(c for c in " | ".join(parts) if c.isprintable())


class ProgressWriter:
    """Writes the line to `stream` (stderr): at most 5 Hz on a terminal, else every 5 s."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._period_ns = round(1e9 * (TERMINAL_PERIOD_S if self._terminal else LOG_PERIOD_S))
        self._last_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether `update` would write: ask before gathering what the line shows."""
        return self._last_ns is None or now_ns - self._last_ns >= self._period_ns

    def update(self, progress: Progress, now_ns: int) -> None:
        """Write the line if the last one is old enough (`now_ns`: wall clock, monotonic)."""
        if not self.due(now_ns):
            return
        self._last_ns = now_ns
        line = format_line(progress)
        if self._terminal:
            self._stream.write(CLEAR_LINE + line[: self._columns() - 1])
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def close(self) -> None:
        """End the rewritten line, so that what follows starts on a line of its own."""
        if self._terminal and self._last_ns is not None:
            self._stream.write("\n")
            self._stream.flush()
        self._last_ns = None

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._stream.fileno()).columns or 80
        except (OSError, ValueError):
            return 80
