"""The client of the motion controller, an action client in ROS's words: goals out, answers in."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from edge.config import Config
from edge.geometry import SE2, wrap_angle
from edge.stuck import StuckDetector
from edge.types import Goal, GoalStatus

log = logging.getLogger("edge.loop.goal_client")

SILENT_NS = 3_000_000_000
# An unanswered goal is reached when the robot stands still this near to it for `ARRIVED_S`, longer
# than a controller takes to answer. Nav2 stops within 0.25 m and 0.25 rad.
ARRIVED_M, ARRIVED_RAD, ARRIVED_S = 0.3, 0.35, 2.0
# A robot that moves this far under goals that nobody answers has a controller all the same.
DRIVEN_M, DRIVEN_RAD = 0.3, 0.5
# A stamp that went through a double comes back up to 128 ns off. Goals are farther apart.
_SAME_NS = 1_000
_KEPT = 256


class GoalClient:
    """Knows what the controller was told last, and what it said of that.

    Args:
        transmit: hands a goal to those who transmit it.

    Attributes:
        driving: whether the controller has a goal that it has not finished with.
        heard: whether a controller answers, or none is expected to.
    """

    def __init__(self, config: Config, transmit: Callable[[Goal], None]) -> None:
        self.driving = False
        self.heard = config.goals_unanswered
        self._expects_answers = not config.goals_unanswered
        arrived_s = max(ARRIVED_S, 3.0 / config.observed_hz)
        self._arrival = StuckDetector(arrived_s)
        self._unheard_at: SE2 | None = None  # where the robot was when nobody began to answer
        self._moved = False  # since then
        self._transmit = transmit
        self._stamps_ns: deque[int] = deque(maxlen=_KEPT)  # of the goals that were sent
        self._stranger_told = False
        self._sent_ns: int | None = None  # stamp of the goal that the controller drives to
        self._blocked: tuple[float, float] | None = None
        self._unanswered_since_ns: int | None = None
        self._silence_told = False

    def send(self, goal: Goal, now_ns: int) -> None:
        """The controller is to drive to this goal, in place of the last."""
        if self._unanswered_since_ns is None:
            self._unanswered_since_ns = now_ns
        self._sent_ns = goal.stamp_ns
        self._stamps_ns.append(goal.stamp_ns)
        self.driving = True
        self._arrival.reset()
        self._transmit(goal)

    def matched(self, answer: GoalStatus) -> GoalStatus:
        """Return the answer with the stamp of the goal that it means, which may be slightly off.

        An answer to no goal that was sent is returned as it is, and reported once.
        """
        stamp_ns = answer.stamp_ns
        nearest_ns = min(self._stamps_ns, key=lambda sent_ns: abs(sent_ns - stamp_ns), default=None)
        if nearest_ns is None or nearest_ns == stamp_ns:
            return answer
        if abs(nearest_ns - stamp_ns) <= _SAME_NS:
            return replace(answer, stamp_ns=nearest_ns)
        if not self._stranger_told:
            self._stranger_told = True
            log.warning(
                "goal_status: no goal has the stamp %d (the nearest is %d): the controller must "
                "return the goal's own stamp, in whole nanoseconds (further ones are not reported)",
                stamp_ns, nearest_ns,
            )  # fmt: skip
        return answer

    def answered(self, answer: GoalStatus, goal: Goal | None) -> bool:
        """The controller said something; what it says of old goals only shows that it is there.

        Args:
            goal: that was sent and is still being followed up; None for none.

        Returns:
            Whether it is said of that goal.
        """
        self.heard = True
        self._unanswered_since_ns = None
        if answer.stamp_ns == self._sent_ns:  # it drives on to a goal that is none any more
            self._blocked = answer.blocked or self._blocked
        if goal is None or answer.stamp_ns != goal.stamp_ns:
            return False
        self.driving = answer.state == "accepted"
        return True

    def take_blocked(self) -> tuple[float, float] | None:
        """Where it said since the last call that the robot is held up; None: nowhere."""
        blocked, self._blocked = self._blocked, None
        return blocked

    def notice_silence(self, now_ns: int) -> None:
        """Notice, and say once, that nobody answers."""
        since_ns = self._unanswered_since_ns
        if not self._expects_answers or since_ns is None or now_ns - since_ns < SILENT_NS:
            return
        self.heard = False
        if not self._silence_told:
            self._silence_told = True
            log.warning(
                "no motion controller answers on goal_status: a goal counts as reached when the "
                "robot stops there"
            )

    def arrived(self, goal: Goal, pose: SE2, now_ns: int) -> GoalStatus | None:
        """Answer for a controller that says nothing of this goal: the robot stopped there.

        Only a goal to look somewhere asks for its heading: many controllers do not turn at the end.

        Returns:
            The answer, once; None before that.
        """
        near = pose.distance_to(goal.pose.x_m, goal.pose.y_m) <= ARRIVED_M
        if goal.kind == "look":
            near = near and _turned_rad(pose, goal.pose) <= ARRIVED_RAD
        if not self._arrival.update(pose, near, now_ns):
            return None
        self.driving = False
        return GoalStatus(goal.stamp_ns, "reached", "the robot stopped there")

    def is_driven(self, pose: SE2) -> bool:
        """Return whether the robot is driven to the last goal: a controller has it and answers, or
        the robot has moved although none does."""
        if self.heard:
            self._unheard_at, self._moved = None, False
        if self.heard or not self.driving:
            return self.driving
        start = self._unheard_at = self._unheard_at or pose
        far = pose.distance_to(start.x_m, start.y_m) >= DRIVEN_M
        self._moved = self._moved or far or _turned_rad(pose, start) >= DRIVEN_RAD
        return self._moved

    def forget_places(self) -> None:
        """The pose jumped: what is said of the last goal is said of another frame."""
        self._sent_ns = self._blocked = self._unheard_at = None
        self._arrival.reset()


def _turned_rad(pose: SE2, other: SE2) -> float:
    return abs(wrap_angle(pose.yaw_rad - other.yaw_rad))
