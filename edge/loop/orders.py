"""What the motion controller was told, what it answered, and telling it to stand.

A controller drives to the last goal that it heard until it is there. So a goal that is given up
is taken back: by one at the place where the robot is.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from edge.geometry import SE2
from edge.types import Goal, GoalStatus

log = logging.getLogger("edge.loop.service")

# A goal that is dropped in one tick and chosen again in one of the next is not taken back.
GRACE_NS = 300_000_000
SILENT_NS = 3_000_000_000


class Orders:
    """The goals that went out; for one thread.

    Args:
        tell: hands a goal to those who send it.

    Attributes:
        target: what the goals are for.
        answer: the controller's newest answer to the present goal; None before it came.
        blocked: where it said that the robot was held up on the way there, if it did.
        driving: whether the controller has a goal that it has not finished with.
        heard: whether a controller answers.
    """

    def __init__(self, tell: Callable[[Goal], None]) -> None:
        self.target = ""
        self.answer: GoalStatus | None = None
        self.blocked: tuple[float, float] | None = None
        self.driving = False
        self.heard = False
        self._tell = tell
        self._goal: Goal | None = None
        self._without_since_ns: int | None = None
        self._unanswered_since_ns: int | None = None
        self._grace_ns = GRACE_NS
        self._told = False

    def give(self, goal: Goal, now_ns: int) -> bool:
        """Send a goal, unless it is the one being driven to; whether it was sent."""
        self._without_since_ns = None
        self._listen(now_ns)
        if goal is self._goal:
            return False
        self._send(goal, now_ns)
        self.driving = True
        return True

    def give_none(self, pose: SE2, now_ns: int) -> None:
        """There is no goal: after a while the one before is taken back."""
        self.withdraw()
        self._listen(now_ns)
        if self._without_since_ns is None:
            self._without_since_ns = now_ns
        if self.driving and now_ns - self._without_since_ns >= self._grace_ns:
            self.stand(pose, now_ns)

    def withdraw(self, at_once: bool = False) -> None:
        """The present goal counts no more; answers to it are void.

        Args:
            at_once: have the robot stand in the next tick that has no other goal.
        """
        self._goal = self.answer = self.blocked = None
        if at_once:
            self._grace_ns = 0

    def stand(self, pose: SE2, now_ns: int) -> None:
        """Have the robot stay where it is; the goal for that is nobody's to follow up."""
        here = (pose.x_m, pose.y_m)
        self._send(Goal(now_ns, pose, "look", 0, here, 0.0, self.target), now_ns)
        self.withdraw()
        self.driving = False

    def answered(self, answer: GoalStatus) -> None:
        """The controller said something; what it says of old goals only shows that it is there."""
        self.heard = True
        self._unanswered_since_ns = None
        if self._goal is not None and answer.stamp_ns == self._goal.stamp_ns:
            self.answer = answer
            self.blocked = answer.blocked or self.blocked
            self.driving = answer.state == "accepted"

    def _send(self, goal: Goal, now_ns: int) -> None:
        self._goal, self._grace_ns = goal, GRACE_NS
        self.answer = self.blocked = None
        if self._unanswered_since_ns is None:
            self._unanswered_since_ns = now_ns
        self._tell(goal)

    def _listen(self, now_ns: int) -> None:
        """Notice, and say once, that nobody answers."""
        since_ns = self._unanswered_since_ns
        if since_ns is None or now_ns - since_ns < SILENT_NS:
            return
        self.heard = False
        if not self._told:
            self._told = True
            log.warning("no motion controller answers on goal_status")
