"""Noticing a robot that moves and gets nowhere."""

from __future__ import annotations

NEARER_M = 0.1
DETOURS = 8


class Progress:
    """Whether the way left keeps getting shorter.

    A longer way is a detour that a newer map has forced: it starts the wait afresh, but only
    so many times, so that a robot that swings between two paths is found out too.
    """

    def __init__(self, wait_s: float) -> None:
        self._wait_ns = int(wait_s * 1e9)
        self.reset()

    def reset(self) -> None:
        self._best_m: float | None = None
        self._since_ns = 0
        self._detours = 0

    def update(self, remaining_m: float, now_ns: int) -> bool:
        """False when the wait is over without the robot having come `NEARER_M` nearer."""
        if self._best_m is None or remaining_m <= self._best_m - NEARER_M:
            self._best_m, self._since_ns = remaining_m, now_ns
        elif remaining_m > self._best_m + 1.0 and self._detours < DETOURS:
            self._detours += 1
            self._best_m, self._since_ns = remaining_m, now_ns
        return now_ns - self._since_ns < self._wait_ns
