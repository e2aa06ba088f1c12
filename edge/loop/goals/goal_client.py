"""Client of the motion controller, like a ROS action client: it sends goals, receives statuses."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from edge.config import Config
from edge.geometry import SE2, wrap_angle
from edge.stuck import StuckDetector
from edge.types import Goal, GoalStatus

log = logging.getLogger("edge.loop.goals.goal_client")

# A controller that sends no goal status for this time after a goal counts as silent.
SILENT_NS = 3_000_000_000
# Without goal statuses, a goal is reached when the robot stands still within ARRIVED_M and
# ARRIVED_RAD of it for ARRIVED_S. Nav2 stops within 0.25 m and 0.25 rad. ARRIVED_S is longer than
# a controller takes to answer.
ARRIVED_M = 0.3
ARRIVED_RAD = 0.35
ARRIVED_S = 2.0
# If the robot moves or turns this far although no status comes, it has a controller.
DRIVEN_M = 0.3
DRIVEN_RAD = 0.5
# A stamp that was converted to a double is up to 128 ns off. Goals are farther apart.
_SAME_NS = 1_000
_MAX_STAMPS = 256


class GoalClient:
    """The state of the controller: the last goal that was sent, and its statuses.

    The stamp of a goal identifies it: a status has the stamp of its goal.

    Attributes:
        driving: True if the controller has a goal that is not finished.
        has_controller: True if a controller answers, or if no answers are expected.
    """

    def __init__(self, config: Config, transmit: Callable[[Goal], None]) -> None:
        self.driving = False
        self.has_controller = config.goals_without_feedback
        self._expects_answers = not config.goals_without_feedback
        arrived_s = max(ARRIVED_S, 3.0 / config.observed_hz)
        self._arrival = StuckDetector(arrived_s)
        self._silent_pose: SE2 | None = None  # pose at which the controller's silence began
        self._moved = False  # True if the robot moved since that silence began
        self._transmit = transmit
        self._stamps_ns: deque[int] = deque(maxlen=_MAX_STAMPS)  # of the goals that were sent
        self._unknown_stamp_logged = False
        self._sent_ns: int | None = None  # stamp of the goal that the controller drives to
        self._blocked: tuple[float, float] | None = None
        self._unanswered_since_ns: int | None = None
        self._silence_logged = False

    def send(self, goal: Goal, now_ns: int) -> None:
        """Send a goal that replaces the last one."""
        if self._unanswered_since_ns is None:
            self._unanswered_since_ns = now_ns
        self._sent_ns = goal.stamp_ns
        self._stamps_ns.append(goal.stamp_ns)
        self.driving = True
        self._arrival.reset()
        self._transmit(goal)

    def hold(self, goal: Goal, now_ns: int) -> None:
        """Send a goal at the robot's own pose, which is finished at once."""
        self.send(goal, now_ns)
        self.driving = False

    def demand_hold(self) -> None:
        """Have a goal to stand still sent: the controller may have one of another service."""
        self.driving = True

    def with_sent_stamp(self, status: GoalStatus) -> GoalStatus:
        """Return the status with the exact stamp of its goal.

        The stamp that the controller returns may be slightly off; see `_SAME_NS`.

        A status that matches no sent goal is returned unchanged and logged once.
        """
        stamp_ns = status.stamp_ns
        nearest_ns = min(self._stamps_ns, key=lambda sent_ns: abs(sent_ns - stamp_ns), default=None)
        if nearest_ns is None or nearest_ns == stamp_ns:
            return status
        if abs(nearest_ns - stamp_ns) <= _SAME_NS:
            return replace(status, stamp_ns=nearest_ns)
        if not self._unknown_stamp_logged:
            self._unknown_stamp_logged = True
            log.warning(
                "goal_status: no goal has the stamp %d (the nearest is %d): the controller must "
                "return the goal's own stamp, an integer [ns] (further ones are not logged)",
                stamp_ns, nearest_ns,
            )  # fmt: skip
        return status

    def on_goal_status(self, status: GoalStatus, goal: Goal | None) -> bool:
        """Handle a goal status. A status for an old goal only counts as a heartbeat.

        Returns:
            True if the status is for this goal.
        """
        self.has_controller = True
        self._unanswered_since_ns = None
        if status.stamp_ns == self._sent_ns:  # also for a goal that is no longer tracked
            self._blocked = status.blocked or self._blocked
        if goal is None or status.stamp_ns != goal.stamp_ns:
            return False
        self.driving = status.state == "accepted"
        return True

    def take_blocked(self) -> tuple[float, float] | None:
        """Return the place where the robot was reported blocked since the last call, or None."""
        blocked, self._blocked = self._blocked, None
        return blocked

    def notice_silence(self, now_ns: int) -> None:
        """Check for a controller that does not answer; log this once."""
        since_ns = self._unanswered_since_ns
        if not self._expects_answers or since_ns is None or now_ns - since_ns < SILENT_NS:
            return
        self.has_controller = False
        if not self._silence_logged:
            self._silence_logged = True
            log.warning(
                "no motion controller answers on goal_status: a goal counts as reached when the "
                "robot stops there"
            )

    def infer_arrival(self, goal: Goal, pose: SE2, now_ns: int) -> GoalStatus | None:
        """Return a status for a controller that sends none, when the robot stopped at the goal.

        The heading is checked only for goals of kind `spin`, because many controllers do not turn
        at the end.

        Returns:
            The status, once; None before that.
        """
        at_goal = pose.distance_to(goal.pose.x_m, goal.pose.y_m) <= ARRIVED_M
        if goal.kind == "spin":
            at_goal = at_goal and _turned_rad(pose, goal.pose) <= ARRIVED_RAD
        if not self._arrival.update(pose, at_goal, now_ns):
            return None
        self.driving = False
        return GoalStatus(goal.stamp_ns, "reached", "the robot stopped there")

    def is_driven(self, pose: SE2) -> bool:
        """Return True if a controller drives the robot to the last goal.

        That is so if the controller has the goal and answers, or if the robot has moved although
        no status comes.
        """
        if self.has_controller:
            self._silent_pose, self._moved = None, False
        if self.has_controller or not self.driving:
            return self.driving
        start = self._silent_pose = self._silent_pose or pose
        moved_away = pose.distance_to(start.x_m, start.y_m) >= DRIVEN_M
        self._moved = self._moved or moved_away or _turned_rad(pose, start) >= DRIVEN_RAD
        return self._moved

    def on_pose_jump(self) -> None:
        """Handle a pose jump: statuses of the last goal refer to the old frame."""
        self._sent_ns = self._blocked = self._silent_pose = None
        self._arrival.reset()


def _turned_rad(pose: SE2, other: SE2) -> float:
    return abs(wrap_angle(pose.yaw_rad - other.yaw_rad))
