"""Sink for a robot's ROS 2 graph (`ros2.via`): goals, map, path, trajectory, markers, zones.

Answers of the action NavigateToPose are published as `goal_status`, as any controller does, so
every source receives them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import zenoh

from edge.bus import topics
from edge.bus.ros2.node import Ros2Publisher, open_node
from edge.bus.ros2.topics import LATCHED, PUBLISHED
from edge.bus.session import declare_publisher
from edge.bus.wire import detections, markers, messages, navigation, transforms
from edge.config import Config
from edge.geometry import Grid
from edge.host.worker import Worker
from edge.loop.result import TickResult
from edge.mapping.zones import ZonePolygons
from edge.sinks.drawings import PathRing, boxes_of, drawing_of, markers_of
from edge.sinks.keepout import KeepoutPublisher
from edge.sinks.navigate import DockRobotClient, NavigateToPoseClient, UndockRobotClient
from edge.sinks.rate_limiter import RateLimiter
from edge.tasks.follow import path_message
from edge.tasks.refine import RefinedTrajectory
from edge.types import Goal, GoalStatus

DRAWN_HZ = 1.0
"""Rate of path and markers, and of checks if the robot entered a zone."""
_CLOSE_S = 1.0  # longest time to send what is pending at the end


class Ros2Sink:
    """Publishes to the graph of `ros2`; no method blocks."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        settings = self._settings = config.ros2
        self._frame = settings.map_frame
        self._node = open_node(config, session, "sink")
        self._map, self._path, self._planned, self._markers = map(
            self._publisher, ("map", "path", "trajectory", "markers")
        )
        self._detections, self._objects = (
            None if settings.detections_frame is None else self._publisher(name)
            for name in ("detections", "objects")
        )
        self._keepout = self._keepout_publisher(config) if settings.keepout_filter else None
        self._zones: ZonePolygons | None = None
        # With `ros2.goals: topic` only a publisher of goals; else the clients of Nav2's actions.
        self._goal_publisher = None
        self._navigator: NavigateToPoseClient | None = None
        self._docker: DockRobotClient | None = None
        self._undocker: UndockRobotClient | None = None
        self._status_publisher = None
        if settings.goals == "topic":
            self._goal_publisher = self._publisher("goal")
        else:
            self._status_publisher = declare_publisher(session, topics.GOAL_STATUS, config.zenoh)
            action = settings.topic("navigate_to_pose")
            self._navigator = NavigateToPoseClient(
                self._node, action, self._frame, self._send_status
            )
            if settings.docks:
                docking = settings.topic("dock_robot")
                self._docker = DockRobotClient(
                    self._node, docking, settings.docks, self._frame, self._send_status
                )
                undocking = settings.topic("undock_robot")
                self._undocker = UndockRobotClient(
                    self._node, undocking, self._frame, self._send_status, self._leave_dock
                )
        self._pending_goal: Goal | None = None
        self._driven_path = PathRing()
        self._driving = self._stopped = False
        self._trajectory: RefinedTrajectory | None = None
        self._limiter = RateLimiter(map=config.report.map_hz, drawings=DRAWN_HZ, zones=DRAWN_HZ)
        self._worker = Worker(
            "ros2-sink", self._deliver, finish_on_close=True, periodic=self._update_clients
        )

    def _publisher(self, name: str) -> Ros2Publisher:
        return self._node.publisher(self._settings.topic(name), PUBLISHED[name], name in LATCHED)

    def _keepout_publisher(self, config: Config) -> KeepoutPublisher:
        """Announce the mask of the zones, and return its publisher."""
        mask_topic, mapping = self._settings.topic("keepout_mask"), config.mapping
        info = navigation.encode_keepout_info(0, self._frame, mask_topic)
        self._publisher("keepout_info").put(info)
        put = self._publisher("keepout_mask").put
        return KeepoutPublisher(put, self._frame, mapping.resolution_m, mapping.inflation_m)

    # -- on the loop's thread -------------------------------------------------------------------

    def tick(self, result: TickResult) -> None:
        """Queue what changed; see `edge.loop.result.Sink`."""
        for goal in result.goals:
            self._driving = True
            self._worker.submit(("goal", goal), key="goal")
        if self._driving and result.goal is None:
            self._driving = False
            if self._navigator is not None:  # else the goal to stand still must be sent
                self._worker.submit(("goal", None), key="goal")
        if bool(result.stopped) != self._stopped:
            self._stopped = bool(result.stopped)
            if self._stopped:
                self._worker.submit(("stop", None), key="stop")
        now_ns = result.now_ns
        if result.pose is not None:
            self._driven_path.add(result.pose)
        task = result.task()
        refined = None if task is None else task.refined
        if refined is not self._trajectory:
            self._trajectory = refined
            self._worker.submit(("trajectory", (now_ns, refined)), key="trajectory")
        if self._detections is not None and (found := result.detections) is not None:
            names = [found.prompts[i] for i in found.class_id]
            boxes = found.observation.stamp_ns, names, found.score, found.xyxy_px
            self._worker.submit(("detections", boxes), key="detections")
        if self._keepout is not None:
            is_due = self._limiter.take_turn("zones", now_ns)  # the robot may have entered one
            if is_due or result.zones is not self._zones:
                self._zones = result.zones
                self._worker.submit(("zones", (now_ns, result.zones, result.pose)), key="zones")
        if self._limiter.take_turn("map", now_ns):
            self._worker.submit(("map", (now_ns, result.snapshot)), key="map")
        if self._limiter.take_turn("drawings", now_ns):
            drawn = now_ns, self._driven_path.poses(), drawing_of(result)
            self._worker.submit(("drawings", drawn), key="drawings")

    def status(self) -> dict[str, Any]:
        """Return worker statistics; see `edge.loop.result.Sink`."""
        return self._worker.stats.status()

    def close(self) -> None:
        """Cancel the goal, and send what is pending."""
        self._worker.submit(("goal", None), key="goal")
        if self._worker.close(_CLOSE_S):
            self._node.close()
            if self._status_publisher is not None:
                self._status_publisher.undeclare()

    # -- on the worker's thread ------------------------------------------------------------------

    def _deliver(self, message: tuple[str, Any]) -> None:
        """Publish one queued item."""
        name, item = message
        if name == "goal":
            self._drive(item)
        elif name == "stop":
            for client in (self._navigator, self._docker, self._undocker):
                if client is not None:
                    client.cancel_all()
        elif name == "map":
            stamp_ns, copy_map = item
            self._map.put(_encode_map(stamp_ns, copy_map, self._frame))
        elif name == "zones" and self._keepout is not None:
            self._keepout.update(*item)
        elif name == "detections" and self._detections is not None:
            stamp_ns, *boxes = item
            frame = self._settings.detections_frame
            self._detections.put(detections.encode_detections(stamp_ns, frame, *boxes))
        elif name == "trajectory":
            stamp_ns, refined = item
            self._planned.put(path_message(refined, stamp_ns, self._frame))
        else:
            stamp_ns, driven, drawing = item
            self._path.put(transforms.encode_path(stamp_ns, self._frame, driven))
            payload = markers.encode_markers(stamp_ns, self._frame, markers_of(drawing))
            self._markers.put(payload)
            if self._objects is not None:
                boxes = boxes_of(drawing)
                self._objects.put(detections.encode_boxes(stamp_ns, self._frame, boxes))

    def _drive(self, goal: Goal | None) -> None:
        """Send a goal to the client that must act first, and cancel the others.

        None cancels all.
        """
        if self._navigator is None:
            self._pending_goal = goal
            self._update_clients()
            return
        client = None if goal is None else self._client_for(goal)
        for other in (self._navigator, self._docker, self._undocker):
            if other is not None and other is not client:
                other.cancel()
        if goal is not None and client is not None:
            client.send(goal)
        self._update_clients()

    def _client_for(self, goal: Goal) -> NavigateToPoseClient | None:
        """Return the client of the action that must come first for a goal."""
        if self._docker is not None and self._docker.is_dock_goal(goal):
            return self._docker
        is_docked = self._docker is not None and self._docker.docked
        return self._undocker if is_docked else self._navigator

    def _leave_dock(self, goal: Goal) -> None:
        """Drive to a goal after undocking."""
        assert self._docker is not None
        assert self._navigator is not None
        self._docker.docked = False
        self._navigator.send(goal)

    def _update_clients(self) -> None:
        """Update the clients, and send a pending goal; the worker calls this periodically."""
        self._node.update()
        for docking in (self._docker, self._undocker):
            if docking is not None:
                docking.update()
        if self._navigator is not None:
            self._navigator.update()
        # A planner treats each message as a new goal: send once, when there is a subscriber.
        elif (
            self._pending_goal is not None
            and self._goal_publisher is not None
            and self._goal_publisher.has_subscribers()
        ):
            goal, self._pending_goal = self._pending_goal, None
            self._goal_publisher.put(
                messages.encode_pose_stamped(goal.stamp_ns, goal.pose, self._frame)
            )

    def _send_status(self, answer: GoalStatus) -> None:
        fields = {"stamp": answer.stamp_ns, "state": answer.state, "reason": answer.reason}
        self._status_publisher.put(json.dumps(fields).encode())


def _encode_map(stamp_ns: int, copy_map: Callable[[], Grid], frame_id: str) -> bytes:
    return messages.encode_occupancy_grid(stamp_ns, copy_map(), frame_id)
