"""A robot on ROS 2, out of the simulated one: `python ros_robot.py ENDPOINT PREFIX` in its Python.

The simulator and the reference controller connect to it over Zenoh, and to nobody else. What the
sensors say it publishes on DDS; it serves NavigateToPose by giving the goal to the controller, with
the map that comes over DDS. So it is a Nav2 of our own making around the real action's type.
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
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image

SENSORS = {
    "camera/rgb": Image, "camera/depth": Image, "camera/info": CameraInfo, "odom": Odometry,
}  # fmt: skip


class Robot:
    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self.node = rclpy.create_node("robot")
        self._session, self._prefix = session, prefix
        self._state: dict[int, tuple[str, str]] = {}
        self.subscribers = []
        for name, kind in SENSORS.items():
            publisher = self.node.create_publisher(kind, f"/{name}", qos_profile_sensor_data)
            self._hear(name, lambda sample, p=publisher: p.publish(sample.payload.to_bytes()))
        self._hear("goal_status", self._on_status)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            OccupancyGrid, "/edge/map", lambda grid: self._put("map", grid), latched, raw=True
        )
        self._server = ActionServer(
            self.node, NavigateToPose, "/navigate_to_pose", self._navigate,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self._newest = 0

    def _hear(self, name: str, callback: object) -> None:
        key = f"{self._prefix}/{name}"
        self.subscribers.append(self._session.declare_subscriber(key, callback))

    def _put(self, name: str, payload: bytes) -> None:
        self._session.put(f"{self._prefix}/{name}", payload)

    def _on_status(self, sample: zenoh.Sample) -> None:
        answer = json.loads(sample.payload.to_bytes())
        self._state[answer["stamp"]] = answer["state"], answer.get("reason", "")

    def _navigate(self, handle: object) -> NavigateToPose.Result:
        """One goal at a time, as Nav2: the newest ends the one before."""
        pose = handle.request.pose
        stamp_ns = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec
        print(json.dumps({"goal": stamp_ns}), flush=True)
        self._newest = stamp_ns
        payload, told_s = serialize_message(pose), 0.0
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
                self._put("goal", payload)
                handle.publish_feedback(NavigateToPose.Feedback(distance_remaining=1.0))
            time.sleep(0.02)
        return NavigateToPose.Result()


def main(endpoint: str, prefix: str) -> None:
    config = zenoh.Config()
    for key, value in {
        "mode": "peer", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        rclpy.init()
        robot = Robot(session, prefix)
        executor = MultiThreadedExecutor(4)
        executor.add_node(robot.node)
        threading.Thread(target=executor.spin, daemon=True).start()
        print("ready", flush=True)
        sys.stdin.read()  # the test holds the other end
        rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
