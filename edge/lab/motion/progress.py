"""Noticing a robot that drives and gets nowhere."""

from __future__ import annotations

from edge.geometry import SE2

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


class Contact:
    """Whether the robot pushes against something: told to drive, it does not leave its place.

    Args:
        told_m: so far it was told to drive by then. Longer than what a base that is slow to
            answer lets pass before it moves.
        moved_m: what counts as having left the place.
    """

    def __init__(self, told_m: float, moved_m: float) -> None:
        self._enough_m, self._moved_m = told_m, moved_m
        self.reset()

    def reset(self) -> None:
        """The robot was not driving."""
        self._from: SE2 | None = None
        self._told_m = 0.0

    def update(self, pose: SE2, v_mps: float, dt_s: float) -> bool:
        """True once it was told so far in vain.

        Args:
            pose: after `dt_s` in which it was told to drive at `v_mps`, backwards if negative.
        """
        last = self._from
        left = last is None or pose.distance_to(last.x_m, last.y_m) >= self._moved_m
        if left or v_mps == 0.0 or v_mps * self._told_m < 0.0:
            self._from, self._told_m = pose, 0.0
        self._told_m += v_mps * dt_s
        return abs(self._told_m) >= self._enough_m
