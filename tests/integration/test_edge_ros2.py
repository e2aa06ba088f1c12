"""A simulated ROS 2 robot with Nav2 that drives to its target over rmw_zenoh.

It publishes the topics and frames of a built-in configuration; its odometry is not in `map`.
"""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import zenoh
from edge_processes import write_config
from nav2 import Nav2
from ros_messages import from_ros, to_ros
from ros_robots import LOCALIZED, ODOM_IN_MAP, ROBOTS, builtin_config, builtin_data, transforms_of
from ros_router import ours, router
from ros_sdk import Republisher, peers

from edge.bus.ros2.node import Ros2Node
from edge.bus.ros2.topics import SUBSCRIBED
from edge.bus.session import Ring
from edge.bus.wire import messages
from edge.geometry import SE2

SUCCEEDED, ABORTED = 4, 6
# Keys of simulator and controller for topics with another name in ROS; the truth keeps its key.
HIDDEN = {
    name: f"robot/{name}"
    for name in ("camera/rgb", "camera/depth", "camera/info", "lidar/scan", "odom", "goal", "map",
                 "goal_status", "status", "latency", "mission")
}  # fmt: skip


class RosRobot:
    """Publisher of the simulator's data, which drives to Nav2's goals by the controller."""

    def __init__(self, session: zenoh.Session, port: int, name: str) -> None:
        settings, body = builtin_config(name).ros2, ROBOTS[name]
        self._frames = {"odom": "odom", "lidar/scan": body.lidar}
        self._camera = body.camera
        sensors = [n for n in HIDDEN if n in SUBSCRIBED]
        self.nav2 = Nav2(session, "jazzy")
        self._session, self._node = session, Ros2Node(session, 0, "robot")
        self._rings = {n: Ring(session, f"edge/robot/{n}", 64) for n in sensors}

        # By an implementation that is not ours.
        self._publishers = {n: Republisher(port, settings.topic(n), SUBSCRIBED[n]) for n in sensors}
        self._map = self._node.subscription(
            "/edge/occupancy", ("nav_msgs/msg/OccupancyGrid",), 1, latched=True
        )
        self._answers = Ring(session, "edge/robot/goal_status", 64)
        self._moored = self._node.publisher("/tf_static", SUBSCRIBED["tf_static"], latched=True)
        self._moored.put(transforms_of(body.tree))
        self._tf, self._tf_s = self._node.publisher("/tf", SUBSCRIBED["tf"]), 0.0
        self._goal: tuple[bytes, int, bytes] | None = None
        self._taken, self._again_s = 0, 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.002):
            self._node.update()
            if time.monotonic() - self._tf_s > 0.1:
                self._tf_s = time.monotonic()
                self._tf.put(LOCALIZED)
            for name, ring in self._rings.items():
                for sample in ring.take():
                    message = from_ros(sample.payload.to_bytes(), SUBSCRIBED[name])
                    message.header.frame_id = self._frames.get(name, self._camera)
                    self._publishers[name].put(to_ros(message))
            for _, payload in self._map.take():
                stamp_ns, grid = messages.decode_occupancy_grid(payload.to_bytes())
                x_m, y_m = grid.origin_xy_m
                there = replace(grid, origin_xy_m=(x_m - ODOM_IN_MAP.x_m, y_m - ODOM_IN_MAP.y_m))
                self._session.put("edge/robot/map", messages.encode_occupancy_grid(stamp_ns, there))
            self._drive()

    def _drive(self) -> None:
        while self._taken < len(self.nav2.goals):
            goal_id, goal = self.nav2.goals[self._taken]
            self._taken += 1
            if self._goal is not None:
                self._settle(ABORTED)  # as Nav2 ends a replaced goal
            at, stamp = goal.pose.pose, goal.pose.header.stamp
            yaw = 2 * np.arctan2(at.orientation.z, at.orientation.w)
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            assert goal.pose.header.frame_id == "map"
            x_m, y_m = at.position.x - ODOM_IN_MAP.x_m, at.position.y - ODOM_IN_MAP.y_m
            place = SE2(x_m, y_m, float(yaw))
            self._goal = goal_id, stamp_ns, messages.encode_pose_stamped(stamp_ns, place)
            self._again_s = 0.0
        if self._goal is None:
            return
        if time.monotonic() >= self._again_s:
            self._again_s = time.monotonic() + 0.5
            self._session.put("edge/robot/goal", self._goal[2])
        for sample in self._answers.take():
            said = json.loads(sample.payload.to_bytes())
            mine = self._goal is not None and said["stamp"] == self._goal[1]
            if mine and said["state"] != "accepted":
                self._settle(SUCCEEDED if said["state"] == "reached" else ABORTED)

    def _settle(self, status: int) -> None:
        goal_id = self._goal[0]
        self._goal = None
        if self.nav2.asked(goal_id):
            self.nav2.end(goal_id, status)
        else:
            self.nav2.say_status(goal_id, status)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()
        self.nav2.close()


SMALL = {"width_px": 320, "height_px": 240, "rate_hz": 10}


@pytest.mark.slow
def test_a_robot_on_ros2_is_driven_to_its_target(edge, tmp_path):
    with router() as port, ours(port) as session, peers(port):
        zenoh_section = {"endpoint": f"tcp/127.0.0.1:{port}", "mode": "client"}
        data = builtin_data("turtlebot4", ros2={"via": "rmw_zenoh"}, zenoh=zenoh_section)
        data["sensors"]["camera"] |= SMALL
        data |= {"perception": {"detector": {"kind": "sim"}}, "mission": {"target": "television"}}
        (tmp_path / "robot").mkdir()
        there = {**data, "source": {"kind": "zenoh"}, "sinks": ["zenoh"]}
        there["zenoh"] = {**zenoh_section, "topics": HIDDEN}
        simulator = write_config(tmp_path / "robot", **there)
        robot = RosRobot(session, port, "turtlebot4")
        edge("sim", simulator)
        run = edge("run", write_config(tmp_path, **data), "--once")
        assert run.wait() == 0, run.output
        assert "reached: television" in run.output
        assert len(robot.nav2.goals) > 1
        robot.close()
