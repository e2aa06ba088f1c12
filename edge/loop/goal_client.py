"""The client of the motion controller, an action client in ROS's words: goals out, answers in."""

from __future__ import annotations

import logging
from collections.abc import Callable

from edge.types import Goal, GoalStatus

log = logging.getLogger("edge.loop.goal_client")

SILENT_NS = 3_000_000_000


class GoalClient:
    """Knows what the controller was told last, and what it said of that.

    Args:
        transmit: hands a goal to those who transmit it.

    Attributes:
        driving: whether the controller has a goal that it has not finished with.
        heard: whether a controller answers.
    """

    def __init__(self, transmit: Callable[[Goal], None]) -> None:
        self.driving = False
        self.heard = False
        self._transmit = transmit
        self._sent_ns: int | None = None  # stamp of the goal that the controller drives to
        self._blocked: tuple[float, float] | None = None
        self._unanswered_since_ns: int | None = None
        self._silence_told = False

    def send(self, goal: Goal, now_ns: int) -> None:
        """The controller is to drive to this goal, in place of the last."""
        if self._unanswered_since_ns is None:
            self._unanswered_since_ns = now_ns
        self._sent_ns = goal.stamp_ns
        self.driving = True
        self._transmit(goal)

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
        if since_ns is None or now_ns - since_ns < SILENT_NS:
            return
        self.heard = False
        if not self._silence_told:
            self._silence_told = True
            log.warning("no motion controller answers on goal_status")

    def forget_places(self) -> None:
        """The pose jumped: what is said of the last goal is said of another frame."""
        self._sent_ns = self._blocked = None
