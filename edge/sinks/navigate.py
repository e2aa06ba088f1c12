"""Clients of Nav2's actions NavigateToPose, DockRobot and UndockRobot: send goals, report progress.

Nav2's own server drops the old goal when it gets a new one. Other servers may not; there this
client cancels the old goal after `REPLACED_S`. A goal ends with its result, which has the reason.
If the result is lost, for example because a router restarted, the action's `status` topic is used.
A cancellation is repeated until it is answered, or until the status shows that the goal has ended.
"""

from __future__ import annotations

import logging
import math
import time
import uuid
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from edge import names
from edge.bus.ros2.node import PendingReply, Ros2Node
from edge.bus.ros2.topics import DOCK_ROBOT, NAVIGATE_TO_POSE, UNDOCK_ROBOT
from edge.bus.wire import DecodeError, navigation
from edge.bus.wire.navigation import SETTLED, SUCCEEDED
from edge.text import one_line
from edge.types import Goal, GoalStatus

log = logging.getLogger("edge.sinks.ros2")

RETRY_S = 0.5  # time between two requests
RESULT_LATE_S = 1.0  # time that a result may come after the `status` topic has reported the end
GONE_S = 3.0  # time after which a missing action fails the goal; a restarted router is back by then
PATIENCE_S = 5.0  # time without the action before a warning
REPLACED_S = 0.5  # time in which a server with one goal at a time has dropped the replaced goal
_ACCEPT_S = 5.0  # timeout of the answers to a new goal and to a cancellation
_RESULT_S = 600.0  # timeout of a request for the result; it is then sent again
_RING_MESSAGES = 16  # messages of a topic between two updates, and replaced goals
# Status of an unsuccessful end → word for the reason.
_STATES = {navigation.CANCELED: "cancelled", navigation.ABORTED: "aborted"}


@dataclass(slots=True)
class _ActiveGoal:
    """The goal that Nav2 should drive to.

    Attributes:
        goal_id: id of the goal for Nav2.
        stage: `waiting`: not sent; `sent`: not answered; `driving`: accepted.
        reply: pending reply: first the answer to the goal, then its result.
        due_s: when to request again if no reply is pending.
        lost_s: since when the action has been gone; 0: it is there.
        status: status with which the goal ended, from the `status` topic; 0: not ended.
        ended_s: when that status came.
        unwanted: True if the goal is to be cancelled as soon as Nav2 has accepted it.
        recoveries: number of recoveries reported so far.
    """

    goal: Goal
    stage: Literal["waiting", "sent", "driving"] = "waiting"
    goal_id: bytes = b""
    reply: PendingReply = field(default_factory=lambda: PendingReply(None))
    due_s: float = 0.0
    since_s: float = field(default_factory=time.monotonic)
    lost_s: float = 0.0
    status: int = 0
    ended_s: float = 0.0
    unwanted: bool = False
    recoveries: int = 0


@dataclass(slots=True)
class _Cancellation:
    """A cancellation that is not answered yet.

    Attributes:
        replies: pending replies of its requests.
        due_s: when to request again.
    """

    replies: list[PendingReply]
    due_s: float


class NavigateToPoseClient:
    """Sends goals to Nav2 and reports their progress.

    Not thread-safe: one thread calls all methods, and calls `update` in every cycle. Subclasses use
    other Nav2 actions with the same results.

    Args:
        node: the ROS 2 node.
        action: ROS name of the action.
        on_status: called with each new status of a goal.
    """

    _kind, _name = NAVIGATE_TO_POSE, "navigate_to_pose"
    _decode_result = staticmethod(navigation.decode_result)
    _has_feedback = True  # feedback that a mission needs

    def __init__(
        self, node: Ros2Node, action: str, frame_id: str, on_status: Callable[[GoalStatus], None]
    ) -> None:
        self._action, self._frame_id, self._report = action, frame_id, on_status
        below = f"{action}/_action"
        kind = self._kind
        self._send = node.client(f"{below}/send_goal", f"{kind}_SendGoal", _ACCEPT_S)
        self._result = node.client(f"{below}/get_result", f"{kind}_GetResult", _RESULT_S)
        self._cancel = node.client(f"{below}/cancel_goal", "action_msgs/srv/CancelGoal", _ACCEPT_S)
        status = node.subscription(
            f"{below}/status", ("action_msgs/msg/GoalStatusArray",), _RING_MESSAGES
        )
        self._topics = [(status, self._on_status_message)]
        if self._has_feedback:
            feedback = node.subscription(
                f"{below}/feedback", (f"{kind}_FeedbackMessage",), _RING_MESSAGES
            )
            self._topics.append((feedback, self._on_feedback))
        self._active: _ActiveGoal | None = None
        self._replaced: deque[bytes] = deque(maxlen=_RING_MESSAGES)  # goals replaced by newer ones
        self._cancel_replaced_s = math.inf  # when to cancel those that are still active
        self._cancellations: dict[bytes, _Cancellation] = {}  # by goal id
        self._malformed = 0
        self._waiting_logged = False

    def send(self, goal: Goal) -> None:
        """Drive to this goal, and no longer to the previous one."""
        self._cancellations.pop(navigation.ALL_GOALS, None)  # it would cancel this goal, too
        if self._active is not None and self._active.stage != "waiting":
            self._replaced.append(self._active.goal_id)
            self._cancel_replaced_s = math.inf
        self._active = _ActiveGoal(goal)
        self.update()

    def cancel(self) -> None:
        """Cancel the current goal."""
        self._cancel_replaced()
        active = self._active
        if active is None:
            return
        if active.stage == "driving":
            self._active = None
            self._send_cancel(active.goal_id)
        elif active.stage == "sent":
            active.unwanted = True
            # Cancel now as well, in case this service ends: Nav2 may have accepted the goal.
            self._send_cancel(active.goal_id)
        else:
            self._active = None

    def cancel_all(self) -> None:
        """Cancel all goals of the action as soon as it is there, also those of others.

        A service that was killed may have left one.
        """
        self.cancel()
        self._send_cancel(navigation.ALL_GOALS)
        self.update()

    def update(self) -> None:
        """Process what arrived; request again if no reply is pending."""
        for subscription, handler in self._topics:
            for _, payload in subscription.take():
                self._run_step(handler, payload.to_bytes())
        if self._active is not None:
            self._run_step(_STEPS[self._active.stage], self, self._active)
        if time.monotonic() >= self._cancel_replaced_s:
            self._cancel_replaced()
        self._repeat_cancellations()

    def _run_step(self, step: Callable[..., None], *arguments: object) -> None:
        """Run a step; count a malformed message, so that it affects no other."""
        try:
            step(*arguments)
        except DecodeError as error:
            self._malformed += 1
            if self._malformed == 1:
                log.warning("ros2: %s: message ignored: %s; further ones are only counted",
                            self._name, error)  # fmt: skip

    # -- one step a stage -------------------------------------------------------------------------

    def _step_waiting(self, active: _ActiveGoal) -> None:
        """Send the goal when the action server is there."""
        now_s = time.monotonic()
        if not self._send.has_server():
            if now_s - active.since_s > PATIENCE_S and not self._waiting_logged:
                self._waiting_logged = True
                log.warning(
                    "ros2: waiting for the action server %s: is Nav2 running?", self._action
                )
            return
        if now_s < active.due_s:
            return
        active.due_s, self._waiting_logged = now_s + RETRY_S, False
        # A new id for each attempt: a server refuses an id that it knows.
        active.goal_id = uuid.uuid4().bytes
        request = self._encode(active.goal_id, active.goal)
        active.reply, active.stage = self._send.call(request), "sent"

    def _continue_for(self, goal: Goal) -> bool:
        """Continue the current action for a new goal; return False if there is no action.

        For subclasses, whose actions do not depend on the pose of the goal.
        """
        active = self._active
        if active is None or active.unwanted:
            return False
        active.goal = goal
        if active.stage == "driving":
            self._report(GoalStatus(goal.stamp_ns, "accepted"))
        return True

    def _encode(self, goal_id: bytes, goal: Goal) -> bytes:
        """Return the request that sends a goal."""
        return navigation.encode_send_goal(goal_id, goal.stamp_ns, goal.pose, self._frame_id)

    def _step_sent(self, active: _ActiveGoal) -> None:
        """Handle the answer to the goal: accepted, refused, or none in time."""
        payload = active.reply.poll()
        if payload is None:
            if active.reply.done:
                active.stage = "waiting"
                # Nav2 may have accepted the goal: the answer may be lost.
                if active.unwanted:
                    self._active = None
                    self._send_cancel(active.goal_id)
                else:
                    self._replaced.append(active.goal_id)
            return
        self._cancel_replaced_s = time.monotonic() + REPLACED_S
        if not navigation.decode_send_goal_answer(payload):
            self._finish(active, "failed", f"refused by {self._name}")
            return
        active.stage, active.due_s = "driving", 0.0
        active.reply = PendingReply(None)
        if active.unwanted:
            self._active = None
            self._send_cancel(active.goal_id)
            return
        self._report(GoalStatus(active.goal.stamp_ns, "accepted"))
        self._step_driving(active)

    def _step_driving(self, active: _ActiveGoal) -> None:
        """Handle the result of the goal, or ask for it again."""
        payload = active.reply.poll()
        if payload is not None:
            self._report_result(active, self._decode_result(payload))
        elif active.status and time.monotonic() >= active.ended_s + RESULT_LATE_S:
            self._report_result(active, navigation.Result(active.status))
        elif active.reply.done and time.monotonic() >= active.due_s:
            self._request_result(active)

    def _request_result(self, active: _ActiveGoal) -> None:
        """Ask for the result; the goal fails if the action is gone for `GONE_S`."""
        now_s = time.monotonic()
        if self._result.has_server():
            active.due_s, active.lost_s = now_s + RETRY_S, 0.0
            active.reply = self._result.call(navigation.encode_get_result(active.goal_id))
        elif active.lost_s == 0.0:
            active.lost_s = now_s
        elif now_s - active.lost_s > GONE_S:
            self._finish(active, "failed", f"{self._name} is gone")
            self._send_cancel(active.goal_id)  # it may be back, and still drive

    # -- messages from Nav2 -----------------------------------------------------------------------

    def _on_feedback(self, payload: bytes) -> None:
        """Report a new recovery of the present goal."""
        feedback, active = navigation.decode_feedback(payload), self._active
        if active is None or active.stage != "driving" or feedback.goal_id != active.goal_id:
            return
        if feedback.recoveries > active.recoveries:
            active.recoveries = feedback.recoveries
            reason = f"{feedback.recoveries} recoveries, {feedback.distance_m:.1f} m left"
            self._report(GoalStatus(active.goal.stamp_ns, "accepted", reason))

    def _on_status_message(self, payload: bytes) -> None:
        """Note which goals have ended, for results that are lost."""
        active = self._active
        for goal_id, status in navigation.decode_goal_statuses(payload):
            if status in SETTLED:
                self._cancellations.pop(goal_id, None)
            ours = active is not None and goal_id == active.goal_id
            if ours and status in SETTLED and not active.status:
                active.status, active.ended_s = status, time.monotonic()
            elif status in SETTLED and goal_id in self._replaced:
                self._replaced.remove(goal_id)

    def _report_result(self, active: _ActiveGoal, result: navigation.Result) -> None:
        """Report the end of the goal."""
        if result.status == SUCCEEDED:
            self._finish(active, "reached", "")
        elif result.status in SETTLED:
            code = f" (error {result.error_code})" if result.error_code else ""
            text = f": {one_line(result.error)}" if result.error else ""
            self._finish(active, "failed", f"{_STATES[result.status]} by Nav2{code}{text}")
        else:
            self._finish(active, "failed", f"unknown to Nav2 (status {result.status})")

    def _finish(
        self, active: _ActiveGoal, state: Literal["reached", "failed"], reason: str
    ) -> None:
        self._active = None
        if not active.unwanted:
            self._report(GoalStatus(active.goal.stamp_ns, state, reason))

    def _cancel_replaced(self) -> None:
        """Cancel replaced goals that may still be active."""
        for goal_id in self._replaced:
            self._send_cancel(goal_id)
        self._replaced.clear()
        self._cancel_replaced_s = math.inf

    def _send_cancel(self, goal_id: bytes) -> None:
        """Cancel a goal; `update` repeats the request until it is answered."""
        reply = self._cancel.call(navigation.encode_cancel(goal_id))
        due_s = time.monotonic() + RETRY_S if self._cancel.has_server() else 0.0
        self._cancellations[goal_id] = _Cancellation([reply], due_s)
        if len(self._cancellations) > _RING_MESSAGES:  # a server that never answers
            del self._cancellations[next(iter(self._cancellations))]

    def _repeat_cancellations(self) -> None:
        """Forget answered cancellations; request the others again."""
        now_s, has_server = time.monotonic(), self._cancel.has_server()
        for goal_id, one in list(self._cancellations.items()):
            # Any answer will do: "unknown goal" and "has ended" are answers, too.
            if any(reply.poll() is not None for reply in one.replies):
                del self._cancellations[goal_id]
                continue
            one.replies = [reply for reply in one.replies if not reply.done]
            if has_server and now_s >= one.due_s:
                one.due_s = now_s + RETRY_S
                one.replies.append(self._cancel.call(navigation.encode_cancel(goal_id)))


class DockRobotClient(NavigateToPoseClient):
    """Client of the action DockRobot of Nav2's docking server.

    Args:
        node: the ROS 2 node.
        action: its ROS name.
        docks: names of places and the ids of their docks.
        on_status: called with each new status of a goal.

    Attributes:
        docked: True after docking has succeeded; the caller sets it to False after undocking.
    """

    _kind, _name, _has_feedback = DOCK_ROBOT, "dock_robot", False
    _decode_result = staticmethod(
        partial(navigation.decode_result, has_success=True, has_retries=True)
    )

    def __init__(
        self,
        node: Ros2Node,
        action: str,
        docks: Mapping[str, str],
        frame_id: str,
        on_status: Callable[[GoalStatus], None],
    ) -> None:
        super().__init__(node, action, frame_id, on_status)
        self.docked = False
        self._docks = {names.normalise(place): dock for place, dock in docks.items()}

    def is_dock_goal(self, goal: Goal) -> bool:
        """Return True if a goal is at a place with a dock."""
        return goal.kind == "place" and names.normalise(goal.target) in self._docks

    def send(self, goal: Goal) -> None:
        """Dock at this goal's place. A robot that is docking there goes on, for the new goal."""
        if (
            self._active is None
            or self._active.goal.target != goal.target
            or not self._continue_for(goal)
        ):
            super().send(goal)

    def _finish(
        self, active: _ActiveGoal, state: Literal["reached", "failed"], reason: str
    ) -> None:
        self.docked |= state == "reached"
        super()._finish(active, state, reason)

    def _encode(self, goal_id: bytes, goal: Goal) -> bytes:
        dock_id = self._docks[names.normalise(goal.target)]
        return navigation.encode_dock_goal(goal_id, goal.stamp_ns, dock_id, self._frame_id)


class UndockRobotClient(NavigateToPoseClient):
    """Client of the action UndockRobot of Nav2's docking server.

    Args:
        node: the ROS 2 node.
        action: its ROS name.
        on_status: called with each new status of a goal.
        go_on: called with the goal to drive to, after undocking has succeeded.
    """

    _kind, _name, _has_feedback = UNDOCK_ROBOT, "undock_robot", False
    _decode_result = staticmethod(partial(navigation.decode_result, has_success=True))

    def __init__(
        self,
        node: Ros2Node,
        action: str,
        frame_id: str,
        on_status: Callable[[GoalStatus], None],
        go_on: Callable[[Goal], None],
    ) -> None:
        super().__init__(node, action, frame_id, on_status)
        self._go_on = go_on

    def send(self, goal: Goal) -> None:
        """Undock for this goal. A robot that is undocking goes on, for the new goal."""
        if not self._continue_for(goal):
            super().send(goal)

    def _encode(self, goal_id: bytes, goal: Goal) -> bytes:
        return navigation.encode_undock_goal(goal_id)

    def _finish(
        self, active: _ActiveGoal, state: Literal["reached", "failed"], reason: str
    ) -> None:
        if state == "reached" and not active.unwanted:
            self._active = None
            self._go_on(active.goal)
        else:
            super()._finish(active, state, reason)


_STEPS: dict[str, Callable[[NavigateToPoseClient, _ActiveGoal], None]] = {
    "waiting": NavigateToPoseClient._step_waiting,
    "sent": NavigateToPoseClient._step_sent,
    "driving": NavigateToPoseClient._step_driving,
}
