"""A robot's ROS 2 for `test_ros2.py`: `python ros_echo.py`, in ROS's Python.

Each line on standard input is the name of a message (`rgb`, `scan` or `odom`) and a stamp in ns; it
publishes this message. It prints the stamp of each goal of NavigateToPose, and reports the goal as
reached at once.
"""

from __future__ import annotations

import sys
import threading

import rclpy
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, GoalResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, LaserScan


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("robot")
    scan = LaserScan(angle_increment=0.01, range_max=10.0, ranges=[2.0] * 628)
    odometry = Odometry(child_frame_id="base_link")
    odometry.pose.pose.orientation.w = 1.0
    messages = {
        "rgb": (Image(height=8, width=8, encoding="rgb8", step=24, data=bytes(192)), "/camera"),
        "scan": (scan, "/scan"),
        "odom": (odometry, "/odom"),
    }
    publishers = {
        name: node.create_publisher(type(message), topic, qos_profile_sensor_data)
        for name, (message, topic) in messages.items()
    }

    def on_goal(goal: NavigateToPose.Goal) -> GoalResponse:
        stamp = goal.pose.header.stamp
        print("goal", stamp.sec * 10**9 + stamp.nanosec, flush=True)
        return GoalResponse.ACCEPT

    def navigate(handle: object) -> NavigateToPose.Result:
        handle.succeed()
        return NavigateToPose.Result()

    server = ActionServer(
        node, NavigateToPose, "/navigate_to_pose", navigate, goal_callback=on_goal
    )
    executor = MultiThreadedExecutor(2)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:
        name, stamp_ns = line.split()
        message = messages[name][0]
        message.header.frame_id = "odom"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp_ns), 10**9)
        publishers[name].publish(message)
    server.destroy()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
