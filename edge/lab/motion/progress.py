"""Detection of a robot that drives without progress, or that pushes against an obstacle."""

from __future__ import annotations

from edge.geometry import SE2

NEARER_M = 0.1  # a rest of the path that is shorter by this is progress
DETOURS = 8  # most detours that restart the wait
_DETOUR_M = 1.0  # a path that is longer by more than this is a detour


class ProgressMonitor:
    """Checks that the rest of the path gets shorter, at least once in `wait_s`.

    A longer path is a detour that a newer map has forced: it restarts the wait. At most `DETOURS`
    detours restart it, so that a robot that swings between two paths is detected too.
    """

    def __init__(self, wait_s: float) -> None:
        self._wait_ns = int(wait_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Start again, for a new goal."""
        self._best_m: float | None = None
        self._since_ns = 0
        self._detours = 0

    def update(self, remaining_m: float, now_ns: int) -> bool:
        """Return True while there is progress: False after `wait_s` without one."""
        if self._best_m is None or remaining_m <= self._best_m - NEARER_M:
            self._best_m, self._since_ns = remaining_m, now_ns
        elif remaining_m > self._best_m + _DETOUR_M and self._detours < DETOURS:
            self._detours += 1
            self._best_m, self._since_ns = remaining_m, now_ns
        return now_ns - self._since_ns < self._wait_ns


class ContactDetector:
    """Detects that the robot pushes against something: it is commanded to drive, but does not move.

    A commanded distance of `commanded_m` without a movement of `moved_m` is contact. It must be
    longer than what a slow base is commanded until it starts to move.
    """

    def __init__(self, commanded_m: float, moved_m: float) -> None:
        self._contact_m, self._moved_m = commanded_m, moved_m
        self.reset()

    def reset(self) -> None:
        """Start again: the robot was not driving."""
        self._moved_at: SE2 | None = None  # pose at the last movement
        self._since_m = 0.0  # commanded distance since then, negative for backwards

    def update(self, pose: SE2, v_mps: float, dt_s: float) -> bool:
        """Return True if the commanded distance since the last movement is `commanded_m` or more.

        `v_mps` was commanded in the step that led to this pose; it is negative for backwards.
        """
        last = self._moved_at
        has_moved = last is None or pose.distance_to(last.x_m, last.y_m) >= self._moved_m
        # The distance also starts at 0 again after a command to stand or to drive the other way.
        if has_moved or v_mps == 0.0 or v_mps * self._since_m < 0.0:
            self._moved_at, self._since_m = pose, 0.0
        self._since_m += v_mps * dt_s
        return abs(self._since_m) >= self._contact_m
