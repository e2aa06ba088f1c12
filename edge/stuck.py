"""Noticing a robot that is told to move and does not (VL-Nav V.D)."""

from __future__ import annotations

from edge.geometry import SE2, wrap_angle

STUCK_M = 0.05
# Turning on the spot is moving too: this much of it counts like `stuck_m`.
TURN_RAD = 0.2


class StuckDetector:
    """Says when the pose stayed within `stuck_m` (and 0.2 rad) for `stuck_s` under orders to move.

    Time in which the robot was not told to move does not count, nor does it start the wait
    afresh: a robot that is held up may be given one goal after another, with pauses between.
    """

    def __init__(self, stuck_s: float, stuck_m: float = STUCK_M) -> None:
        self._wait_ns = int(stuck_s * 1e9)
        self._stuck_m = stuck_m
        self.reset()

    def reset(self) -> None:
        """Forget the past, for example when the robot is given something else to do."""
        self._anchor: SE2 | None = None
        self._told_ns = self._last_ns = 0

    def update(self, pose: SE2, moving_commanded: bool, now_ns: int) -> bool:
        """Whether the robot has been stuck for `stuck_s`; True once, then it waits as long again.

        Args:
            moving_commanded: whether the robot was told to move since the last call.
            now_ns: of the pose; time that goes back, or in which for half of the wait nobody
                looked, starts the wait afresh.
        """
        passed_ns, self._last_ns = now_ns - self._last_ns, now_ns
        seen = 0 <= passed_ns <= self._wait_ns // 2
        if self._anchor is None or self._has_moved(pose) or not seen:
            self._anchor, self._told_ns = pose, 0
            return False
        if moving_commanded:
            self._told_ns += passed_ns
        if self._told_ns < self._wait_ns:
            return False
        self._anchor, self._told_ns = pose, 0
        return True

    def _has_moved(self, pose: SE2) -> bool:
        anchor = self._anchor
        turned = abs(wrap_angle(pose.yaw_rad - anchor.yaw_rad))
        return pose.distance_to(anchor.x_m, anchor.y_m) >= self._stuck_m or turned >= TURN_RAD
