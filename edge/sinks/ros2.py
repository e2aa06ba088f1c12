"""Sink for a robot's ROS 2 graph (`ros2.via`): goals, map, path, trajectory, markers, zones.

Answers of the action NavigateToPose are published as `goal_status`, as any controller does, so
every source receives them.
"""

from __future__ import annotations

from typing import Any

import zenoh

from edge.bus.ros2.node import Ros2Publisher, open_node
from edge.bus.ros2.topics import LATCHED, PUBLISHED
from edge.bus.wire import detections, markers, messages, navigation, transforms
from edge.config import Config
from edge.host.worker import Worker
from edge.loop.result import TickResult
from edge.mapping.zones import ZonePolygons
from edge.sinks.drawings import PathRing, boxes_of, drawing_of, markers_of
from edge.sinks.keepout import KeepoutPublisher
from edge.sinks.rate_limiter import RateLimiter
from edge.sinks.ros2_goals import GoalActions, GoalTopic
from edge.tasks.follow import path_message
from edge.tasks.refine import RefinedTrajectory

DRAWN_HZ = 1.0
"""Rate of path and markers, and of checks if the robot entered a zone."""
_CLOSE_S = 1.0  # longest time to send what is pending at the end


class Ros2Sink:
    """Publishes to the graph of `ros2`; no method blocks."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        settings = self._settings = config.ros2
        self._frame = settings.map_frame
        self._node = open_node(config, session, "sink")
        names = ["map", "path", "trajectory", "markers"]
        names += [] if settings.detections_frame is None else ["detections", "objects"]
        self._publishers = {name: self._publisher(name) for name in names}
        self._keepout = self._keepout_publisher(config) if settings.keepout_filter else None
        self._zones: ZonePolygons | None = None
        self._goals: GoalTopic | GoalActions = (
            GoalTopic(self._publisher("goal"), self._frame)
            if settings.goals == "topic"
            else GoalActions(config, self._node, session)
        )
        self._driven_path = PathRing()
        self._driving = self._stopped = False
        self._trajectory: RefinedTrajectory | None = None
        self._limiter = RateLimiter(map=config.report.map_hz, drawings=DRAWN_HZ, zones=DRAWN_HZ)
        self._worker = Worker(
            "ros2-sink", self._deliver, finish_on_close=True, periodic=self._update
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
        # Goals and stops keep their order: none replaces an earlier one that waits.
        for goal in result.goals:
            self._driving = True
            self._worker.enqueue(("goal", goal))
        if self._driving and result.goal is None:
            self._driving = False
            if self._goals.cancels:  # else the goal to stand still must be sent
                self._worker.enqueue(("goal", None))
        if bool(result.stopped) != self._stopped:
            self._stopped = bool(result.stopped)
            if self._stopped:
                self._worker.enqueue(("stop", None))
        now_ns = result.now_ns
        if result.pose is not None:
            self._driven_path.add(result.pose)
        task = result.task()
        refined = None if task is None else task.refined
        if refined is not self._trajectory:
            self._trajectory = refined
            self._worker.submit(("trajectory", (now_ns, refined)), key="trajectory")
        found = result.detections
        # `detections_frame` is that of the first camera.
        is_first_camera = found is not None and found.observation.camera_index == 0
        if "detections" in self._publishers and is_first_camera:
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
        self._worker.enqueue(("goal", None))
        if self._worker.close(_CLOSE_S):
            self._node.close()
            self._goals.close()

    # -- on the worker's thread ------------------------------------------------------------------

    def _deliver(self, message: tuple[str, Any]) -> None:
        """Publish one queued item."""
        name, item = message
        publishers, frame = self._publishers, self._frame
        if name == "goal":
            self._goals.drive(item)
            self._update()
        elif name == "stop":
            self._goals.cancel_all()
        elif name == "map":
            stamp_ns, copy_map = item
            publishers[name].put(messages.encode_occupancy_grid(stamp_ns, copy_map(), frame))
        elif name == "zones" and self._keepout is not None:
            self._keepout.update(*item)
        elif name == "detections":
            stamp_ns, *boxes = item
            camera = self._settings.detections_frame
            publishers[name].put(detections.encode_detections(stamp_ns, camera, *boxes))
        elif name == "trajectory":
            stamp_ns, refined = item
            publishers[name].put(path_message(refined, stamp_ns, frame))
        else:
            stamp_ns, driven, drawing = item
            publishers["path"].put(transforms.encode_path(stamp_ns, frame, driven))
            payload = markers.encode_markers(stamp_ns, frame, markers_of(drawing))
            publishers["markers"].put(payload)
            if (objects := publishers.get("objects")) is not None:
                objects.put(detections.encode_boxes(stamp_ns, frame, boxes_of(drawing)))

    def _update(self) -> None:
        """Handle answers, and send a pending goal; the worker calls this periodically."""
        self._node.update()
        self._goals.update()
