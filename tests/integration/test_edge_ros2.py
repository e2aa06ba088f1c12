"""The simulated robot, as a ROS 2 robot with Nav2, on rmw_zenoh and behind what does as
zenoh-bridge-ros2dds does, is driven to its target."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
import zenoh
from edge_processes import write_config
from nav2 import Nav2
from ros_messages import STORE, header, to_ros
from ros_router import ours, router
from ros_sdk import Republisher, peers

from edge.bus.ros2.names import DIALECTS, Dialect
from edge.bus.ros2.node import Node
from edge.bus.session import Ring
from edge.bus.wire import messages
from edge.config import Camera
from edge.geometry import SE2, quaternion_of

SUCCEEDED, ABORTED = 4, 6
# What simulator and controller call what ROS knows by another name; the truth stays where it is.
HIDDEN = {
    name: f"robot/{name}"
    for name in ("camera/rgb", "camera/depth", "camera/info", "odom", "goal", "map", "goal_status",
                 "status", "latency", "mission")
}  # fmt: skip
TYPES = {"camera/rgb": "sensor_msgs/msg/Image", "camera/depth": "sensor_msgs/msg/Image",
         "camera/info": "sensor_msgs/msg/CameraInfo", "odom": "nav_msgs/msg/Odometry"}  # fmt: skip
NAMES = {name: f"/sim/{name}" for name in TYPES}


class RosRobot:
    """Publishes what the simulator sends, and drives by its controller where Nav2 is told to."""

    def __init__(self, session: zenoh.Session, port: int, dialect: Dialect) -> None:
        self.nav2 = Nav2(session, "jazzy", dialect=dialect)
        self._session, self._node = session, Node(session, 0, "robot", dialect)
        self._rings = {name: Ring(session, f"edge/robot/{name}", 64) for name in TYPES}
        if dialect.has_tokens:
            # By an implementation that is not ours.
            self._publishers = {n: Republisher(port, NAMES[n], t) for n, t in TYPES.items()}
        else:
            self._publishers = {n: self._node.publisher(NAMES[n], t) for n, t in TYPES.items()}
        self._map = self._node.subscription(
            "/edge/occupancy", ("nav_msgs/msg/OccupancyGrid",), 1, latched=True
        )
        self._answers = Ring(session, "edge/robot/goal_status", 64)
        self._tf = self._node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        self._goal: tuple[bytes, int, bytes] | None = None
        self._taken, self._again_s = 0, 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _moor(self, frame_id: str) -> None:
        T, types = Camera().T_base_camera(), STORE.types
        moved = types["geometry_msgs/msg/Vector3"](*map(float, T[:3, 3]))
        turned = types["geometry_msgs/msg/Quaternion"](*quaternion_of(T))
        mounted = types["geometry_msgs/msg/TransformStamped"](
            header(1, "base_link"), frame_id, types["geometry_msgs/msg/Transform"](moved, turned)
        )
        self._tf.put(to_ros(types["tf2_msgs/msg/TFMessage"]([mounted])))

    def _run(self) -> None:
        moored = False
        while not self._stop.wait(0.002):
            self._node.look()
            for name, ring in self._rings.items():
                for sample in ring.take():
                    payload = sample.payload.to_bytes()
                    if not moored and name == "camera/rgb":
                        self._moor(messages.peek_header(payload)[1])
                        moored = True
                    self._publishers[name].put(payload)
            for _, payload in self._map.take():
                self._session.put("edge/robot/map", payload)
            self._drive()

    def _drive(self) -> None:
        while self._taken < len(self.nav2.goals):
            goal_id, goal = self.nav2.goals[self._taken]
            self._taken += 1
            if self._goal is not None:
                self._settle(ABORTED)  # as Nav2 ends what it is driven away from
            at, stamp = goal.pose.pose, goal.pose.header.stamp
            yaw = 2 * np.arctan2(at.orientation.z, at.orientation.w)
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            place = SE2(at.position.x, at.position.y, float(yaw))
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


@pytest.mark.slow
@pytest.mark.parametrize("via", DIALECTS)
def test_a_robot_on_ros2_is_driven_to_its_target(edge, tmp_path, via):
    with router() as port, ours(port) as session, peers(port):
        zenoh_section = {"endpoint": f"tcp/127.0.0.1:{port}", "mode": "client"}
        (tmp_path / "robot").mkdir()
        simulator = write_config(tmp_path / "robot", zenoh={**zenoh_section, "topics": HIDDEN})
        service = write_config(
            tmp_path, zenoh=zenoh_section, source={"kind": "ros2"}, sinks=["zenoh", "ros2"],
            ros2={"topics": NAMES, "via": via},
        )  # fmt: skip
        robot = RosRobot(session, port, DIALECTS[via])
        edge("sim", simulator)
        run = edge("run", service, "--once")
        assert run.wait() == 0, run.output
        assert "reached: television" in run.output
        assert len(robot.nav2.goals) > 1
        robot.close()
