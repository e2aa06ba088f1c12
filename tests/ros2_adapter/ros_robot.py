"""A robot on ROS 2, out of the simulated one: `python ros_robot.py PLAN`, in ROS's Python.

The simulator and the reference controller connect to it over Zenoh, and to nobody else. What the
sensors say it publishes on DDS, under its own topics and frames; it serves NavigateToPose by giving
the goal to the controller, with the map that comes over DDS, both moved from `map` to `odom`. So it
is a Nav2 of our own making around the real action's type.

PLAN is JSON: `endpoint`, `topics` (ours: ROS's), `frames` (ours: the frame its messages name), `tf`
and `tf_static` (messages, in hexadecimal) and `odom_in_map` (x and y in metres).
"""

from __future__ import annotations

import json
import sys
import threading
import time

import rclpy
import zenoh
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.action import ActionServer, CancelResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image, LaserScan
from tf2_msgs.msg import TFMessage

KINDS = {
    "camera/rgb": Image, "camera/depth": Image, "camera/info": CameraInfo, "lidar/scan": LaserScan,
    "odom": Odometry,
}  # fmt: skip


class Robot:
    def __init__(self, session: zenoh.Session, plan: dict) -> None:
        self.node = rclpy.create_node("robot")
        self._session, self._moved = session, plan["odom_in_map"]
        self._state: dict[int, tuple[str, str]] = {}
        self._newest = 0
        self.subscribers = []
        for name, frame in plan["frames"].items():
            self._pass(name, plan["topics"][name], frame)
        self._hear("goal_status", self._on_status)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moored = self.node.create_publisher(TFMessage, "/tf_static", latched)
        self._moored.publish(bytes.fromhex(plan["tf_static"]))
        self._localized = self.node.create_publisher(TFMessage, "/tf", 100)
        localized = bytes.fromhex(plan["tf"])
        self.node.create_timer(0.1, lambda: self._localized.publish(localized))
        self.node.create_subscription(OccupancyGrid, "/edge/occupancy", self._on_map, latched)
        self._server = ActionServer(
            self.node, NavigateToPose, "/navigate_to_pose", self._navigate,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def _pass(self, name: str, topic: str, frame: str) -> None:
        publisher = self.node.create_publisher(KINDS[name], topic, qos_profile_sensor_data)

        def publish(sample: zenoh.Sample) -> None:
            message = deserialize_message(sample.payload.to_bytes(), KINDS[name])
            message.header.frame_id = frame
            publisher.publish(message)

        self._hear(name, publish)

    def _hear(self, name: str, callback: object) -> None:
        self.subscribers.append(self._session.declare_subscriber(f"edge/{name}", callback))

    def _put(self, name: str, message: object) -> None:
        self._session.put(f"edge/{name}", serialize_message(message))

    def _on_map(self, grid: OccupancyGrid) -> None:
        self._put("map", self._to_odom(grid, grid.info.origin))

    def _to_odom(self, message: object, pose: object) -> object:
        assert message.header.frame_id == "map"
        pose.position.x -= self._moved[0]
        pose.position.y -= self._moved[1]
        return message

    def _on_status(self, sample: zenoh.Sample) -> None:
        answer = json.loads(sample.payload.to_bytes())
        self._state[answer["stamp"]] = answer["state"], answer.get("reason", "")

    def _navigate(self, handle: object) -> NavigateToPose.Result:
        """One goal at a time, as Nav2: the newest ends the one before."""
        pose = handle.request.pose
        stamp_ns = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec
        print(json.dumps({"goal": stamp_ns}), flush=True)
        self._newest, told_s = stamp_ns, 0.0
        self._to_odom(pose, pose.pose)
        while rclpy.ok():
            state, reason = self._state.get(stamp_ns, ("", ""))
            if state == "reached":
                handle.succeed()
                return NavigateToPose.Result()
            if handle.is_cancel_requested:
                handle.canceled()
                return NavigateToPose.Result()
            if state == "failed" or self._newest != stamp_ns:
                handle.abort()
                return NavigateToPose.Result(error_msg=reason)
            if time.monotonic() - told_s > 0.5:
                told_s = time.monotonic()
                self._put("goal", pose)
                handle.publish_feedback(NavigateToPose.Feedback(distance_remaining=1.0))
            time.sleep(0.02)
        return NavigateToPose.Result()


def main(plan: dict) -> None:
    config = zenoh.Config()
    for key, value in {
        "mode": "peer", "listen/endpoints": [plan["endpoint"]], "scouting/multicast/enabled": False,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        rclpy.init()
        robot = Robot(session, plan)
        executor = MultiThreadedExecutor(4)
        executor.add_node(robot.node)
        threading.Thread(target=executor.spin, daemon=True).start()
        print("ready", flush=True)
        sys.stdin.read()  # the test holds the other end
        rclpy.try_shutdown()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
