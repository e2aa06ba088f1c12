"""Getting a robot free that does not move: back up where the map allows, else turn."""

from __future__ import annotations

from edge.geometry import SE2, wrap_angle
from edge.motion.pursuit import Command, MotionLimits, turn
from edge.trajectory.costmap import CostMap

BACK_MPS = 0.12
BACK_M = 0.2
HELD_M = 0.05
TURN_RAD = 0.6
TIME_NS = 2_500_000_000


class Recovery:
    """One attempt, at most `TIME_NS` long."""

    def __init__(
        self, pose: SE2, costmap: CostMap | None, limits: MotionLimits, now_ns: int
    ) -> None:
        self._start, self._since_ns, self._limits = pose, now_ns, limits
        self._backs_up = costmap is not None and costmap.is_free(*pose.ahead(-BACK_M))

    def is_held(self, pose: SE2) -> bool:
        """Whether it backed up, and the robot is where it was."""
        return self._backs_up and pose.distance_to(self._start.x_m, self._start.y_m) < HELD_M

    def step(self, pose: SE2, now_ns: int) -> Command | None:
        """What to do now; None when the attempt is over."""
        if not 0 <= now_ns - self._since_ns < TIME_NS:
            return None
        if self._backs_up:
            done = pose.distance_to(self._start.x_m, self._start.y_m) >= BACK_M
            return None if done else self._limits.clip(-BACK_MPS, 0.0)
        left = TURN_RAD - abs(wrap_angle(pose.yaw_rad - self._start.yaw_rad))
        return None if left <= 0.05 else turn(left, self._limits)
