"""Senders of navigation goals, chosen by `ros2.goals`: to a topic, or to Nav2's actions."""

from __future__ import annotations

import json

import zenoh

from edge.bus import topics
from edge.bus.ros2.node import Ros2Node, Ros2Publisher
from edge.bus.session import declare_publisher
from edge.bus.wire import messages
from edge.config import Config
from edge.sinks.navigate import DockRobotClient, NavigateToPoseClient, UndockRobotClient
from edge.types import Goal, GoalStatus


class GoalTopic:
    """Publishes goals; nothing answers, and nothing can be cancelled (`cancels`)."""

    cancels = False

    def __init__(self, publisher: Ros2Publisher, frame_id: str) -> None:
        self._publisher, self._frame_id = publisher, frame_id
        self._pending: Goal | None = None

    def drive(self, goal: Goal | None) -> None:
        """Send a goal at the next `update`; None: send none."""
        self._pending = goal

    def cancel_all(self) -> None:
        """Do nothing; a goal to stand still follows."""

    def update(self) -> None:
        """Send the pending goal, once there is a subscriber."""
        goal = self._pending
        # A planner treats each message as a new goal, so it is sent once.
        if goal is not None and self._publisher.has_subscribers():
            self._pending = None
            pose = messages.encode_pose_stamped(goal.stamp_ns, goal.pose, self._frame_id)
            self._publisher.put(pose)

    def close(self) -> None:
        """Do nothing: the node closes the publisher."""


class GoalActions:
    """Drives by the action NavigateToPose, and docks with Nav2's docking server (`ros2.docks`).

    The answers are published as `goal_status`.
    """

    cancels = True

    def __init__(self, config: Config, node: Ros2Node, session: zenoh.Session) -> None:
        settings, frame_id, report = config.ros2, config.ros2.map_frame, self._send_status
        self._status_publisher = declare_publisher(session, topics.GOAL_STATUS, config.zenoh)
        action = settings.topic("navigate_to_pose")
        self._navigator = NavigateToPoseClient(node, action, frame_id, report)
        self._docker: DockRobotClient | None = None
        self._docking: tuple[NavigateToPoseClient, ...] = ()  # clients of the docking server
        if settings.docks:
            action = settings.topic("dock_robot")
            self._docker = DockRobotClient(node, action, settings.docks, frame_id, report)
            action = settings.topic("undock_robot")
            undocker = UndockRobotClient(node, action, frame_id, report, self._leave_dock)
            self._docking = self._docker, undocker

    def drive(self, goal: Goal | None) -> None:
        """Send a goal to the client that must act first, and cancel the others.

        None cancels all.
        """
        client = None if goal is None else self._client_for(goal)
        for other in (self._navigator, *self._docking):
            if other is not client:
                other.cancel()
        if goal is not None and client is not None:
            client.send(goal)

    def cancel_all(self) -> None:
        """Cancel all goals of the actions, also goals that other clients sent."""
        for client in (self._navigator, *self._docking):
            client.cancel_all()

    def update(self) -> None:
        """Handle the answers of Nav2."""
        for client in (*self._docking, self._navigator):
            client.update()

    def close(self) -> None:
        """Stop publishing answers."""
        self._status_publisher.undeclare()

    def _client_for(self, goal: Goal) -> NavigateToPoseClient:
        """Return the client of the action that must come first for a goal."""
        if self._docker is not None:
            if self._docker.is_dock_goal(goal):
                return self._docker
            if self._docker.docked:
                return self._docking[1]
        return self._navigator

    def _leave_dock(self, goal: Goal) -> None:
        """Drive to a goal after undocking."""
        assert self._docker is not None
        self._docker.docked = False
        self._navigator.send(goal)

    def _send_status(self, status: GoalStatus) -> None:
        fields = {"stamp": status.stamp_ns, "state": status.state, "reason": status.reason}
        self._status_publisher.put(json.dumps(fields).encode())
