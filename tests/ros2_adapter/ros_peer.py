"""A robot's ROS 2, for the tests: `python ros_peer.py`, in ROS's Python, never in ours.

It publishes a camera's image and odometry, and once where the camera sits and that a latched stop
button is pressed, while a best-effort one is not; says in JSON lines what
comes to it, and who hears the images; and serves NavigateToPose as the goal's x says, which
`ros_peer_facts.py` names.
"""

from __future__ import annotations

import json
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import TransformStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from ros_peer_facts import ABORTED, ENDLESS, MOUNTED, PIXELS, REJECTED, STAMP_NS
from sensor_msgs.msg import Image
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage


def say(**what: object) -> None:
    print(json.dumps(what), flush=True)


class Peer:
    def __init__(self) -> None:
        self.node = rclpy.create_node("robot")
        self._odometry = self.node.create_publisher(Odometry, "/odom", 10)
        self._images = self.node.create_publisher(Image, "/camera/image", qos_profile_sensor_data)
        self._watched = 0
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(OccupancyGrid, "/edge/occupancy", self._on_map, latched)
        self._moored = self.node.create_publisher(TFMessage, "/tf_static", latched)
        self._moor()
        self._button = self.node.create_publisher(Bool, "/edge/stop", latched)
        self._button.publish(Bool(data=True))  # pressed before the start
        self._loose = self.node.create_publisher(Bool, "/edge/stop", qos_profile_sensor_data)
        self.node.create_timer(0.1, self._publish)
        self._server = ActionServer(
            self.node, NavigateToPose, "/navigate_to_pose", self._navigate,
            goal_callback=self._on_request, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def _publish(self) -> None:
        image = Image(height=8, width=8, encoding="rgb8", step=24, data=PIXELS)
        image.header.stamp = self.node.get_clock().now().to_msg()
        image.header.frame_id = "camera"
        self._images.publish(image)
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.frame_id = "odom"
        odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(STAMP_NS, 10**9)
        odometry.pose.pose.orientation.w = 1.0
        odometry.twist.twist.linear.x = 0.25
        self._odometry.publish(odometry)
        self._loose.publish(Bool(data=False))
        if (watched := self._images.get_subscription_count()) != self._watched:
            self._watched = watched
            say(watched=watched)

    def _moor(self) -> None:
        mounted = TransformStamped(child_frame_id="camera")
        mounted.header.frame_id = "base_link"
        moved = mounted.transform.translation
        moved.x, moved.y, moved.z = MOUNTED
        self._moored.publish(TFMessage(transforms=[mounted]))

    def _on_map(self, grid: OccupancyGrid) -> None:
        info = grid.info
        say(map=[info.width, info.height, round(info.resolution, 3), sum(grid.data)])

    def _on_request(self, goal: NavigateToPose.Goal) -> GoalResponse:
        x = goal.pose.pose.position.x
        say(asked=x)
        return GoalResponse.REJECT if x == REJECTED else GoalResponse.ACCEPT

    def _navigate(self, handle: object) -> NavigateToPose.Result:
        x = handle.request.pose.pose.position.x
        handle.publish_feedback(
            NavigateToPose.Feedback(distance_remaining=2.5, number_of_recoveries=1)
        )
        while x == ENDLESS and not handle.is_cancel_requested:
            time.sleep(0.02)
            if not rclpy.ok():
                return NavigateToPose.Result()
        if x == ENDLESS:
            handle.canceled()
            say(cancelled=x)
            return NavigateToPose.Result()
        time.sleep(0.2)
        if x == ABORTED:
            handle.abort()
            return NavigateToPose.Result(error_code=204, error_msg="no valid path\nfound")
        handle.succeed()
        return NavigateToPose.Result()


def main() -> None:
    rclpy.init()
    peer = Peer()
    executor = MultiThreadedExecutor(4)
    executor.add_node(peer.node)
    threading.Thread(target=executor.spin, daemon=True).start()
    say(ready=True)
    sys.stdin.read()  # the test holds the other end
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
