"""Detection of a robot that is commanded to move but does not move (VL-Nav V.D)."""

from __future__ import annotations

from edge.geometry import SE2, wrap_angle

STUCK_M = 0.05
"""Default of `stuck_m`: a shorter movement does not count."""
TURN_RAD = 0.2
"""Smallest turn that counts as movement."""


class StuckDetector:
    """A detector of a pose that stays within `stuck_m` and `TURN_RAD` while motion is commanded.

    The robot is stuck after `stuck_s` of commanded motion. Time without a motion command does not
    count. Nor does it restart the wait, because a blocked robot may get one goal after another,
    with breaks between them.

    Example:
        >>> detector = StuckDetector(stuck_s=2.0)
        >>> pose = SE2(0.0, 0.0, 0.0)
        >>> [detector.update(pose, True, k * 1_000_000_000) for k in range(1, 4)]
        [False, False, True]
    """

    def __init__(self, stuck_s: float, stuck_m: float = STUCK_M) -> None:
        self._wait_ns = int(stuck_s * 1e9)
        self._stuck_m = stuck_m
        self.reset()

    def reset(self) -> None:
        """Forget the past, for example when the robot gets another mission."""
        self._anchor: SE2 | None = None
        self._commanded_ns = self._last_ns = 0

    def update(self, pose: SE2, moving_commanded: bool, now_ns: int) -> bool:
        """Return True if the robot has been stuck for `stuck_s`, then start the wait again.

        Args:
            pose: Newest pose of the robot.
            moving_commanded: True if motion was commanded since the last call.
            now_ns: Time of the pose. The wait restarts if time goes back, or if the last call was
                more than half of `stuck_s` ago.
        """
        elapsed_ns, self._last_ns = now_ns - self._last_ns, now_ns
        continuous = 0 <= elapsed_ns <= self._wait_ns // 2
        if self._anchor is None or self._has_moved(pose) or not continuous:
            self._anchor, self._commanded_ns = pose, 0
            return False
        if moving_commanded:
            self._commanded_ns += elapsed_ns
        if self._commanded_ns < self._wait_ns:
            return False
        self._anchor, self._commanded_ns = pose, 0
        return True

    def _has_moved(self, pose: SE2) -> bool:
        anchor = self._anchor
        turned = abs(wrap_angle(pose.yaw_rad - anchor.yaw_rad))
        return pose.distance_to(anchor.x_m, anchor.y_m) >= self._stuck_m or turned >= TURN_RAD
