"""Every Zenoh key that the service, the simulator and the controller read or write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Qos = Literal["drop", "urgent", "block"]


@dataclass(frozen=True, slots=True)
class Topic:
    """One key below the configured prefix.

    Attributes:
        type: ROS 2 message (CDR), or `json`.
        qos: `drop`: best effort, newest wins; `urgent`: goes ahead of these, and is sent again
            until it is answered or out of date; `block`: none may be lost, whoever puts it waits,
            which only lockstep may, where time stands still meanwhile.
        rate_hz: the usual rate; 0 = on events.
        writer: who publishes it.
    """

    key: str
    type: str
    qos: Qos
    rate_hz: float
    writer: Literal["sensors", "service", "controller"]

    def under(self, prefix: str) -> str:
        return f"{prefix}/{self.key}"


RGB = Topic("camera/rgb", "sensor_msgs/Image", "drop", 30, "sensors")
DEPTH = Topic("camera/depth", "sensor_msgs/Image", "drop", 30, "sensors")
CAMERA_INFO = Topic("camera/info", "sensor_msgs/CameraInfo", "drop", 1, "sensors")
OBJECT_IDS = Topic("camera/object_ids", "sensor_msgs/Image", "drop", 30, "sensors")
OBJECT_LABELS = Topic("camera/object_labels", "json", "drop", 1, "sensors")
CLOUD = Topic("lidar/points", "sensor_msgs/PointCloud2", "drop", 10, "sensors")
SCAN = Topic("lidar/scan", "sensor_msgs/LaserScan", "drop", 10, "sensors")
ODOMETRY = Topic("odom", "nav_msgs/Odometry", "drop", 60, "sensors")
GROUND_TRUTH = Topic("sim/ground_truth", "json", "drop", 10, "sensors")

GOAL = Topic("goal", "geometry_msgs/PoseStamped", "urgent", 0, "service")
MAP = Topic("map", "nav_msgs/OccupancyGrid", "drop", 2, "service")
STATUS = Topic("status", "json", "drop", 1, "service")
LATENCY = Topic("latency", "json", "drop", 1, "service")
MISSION = Topic("mission", "json", "urgent", 0, "service")
TICK = Topic("tick", "json", "block", 0, "service")

CMD_VEL = Topic("cmd_vel", "geometry_msgs/TwistStamped", "drop", 20, "controller")
GOAL_STATUS = Topic("goal_status", "json", "urgent", 0, "controller")

# Not topics but queryables: requests about the mission and the perception's model, JSON both ways
# (see `edge.loop.requests`).
MISSION_REQUEST = "mission/request"
MODELS_REQUEST = "models/request"

ALL: tuple[Topic, ...] = (
    RGB, DEPTH, CAMERA_INFO, OBJECT_IDS, OBJECT_LABELS, CLOUD, SCAN, ODOMETRY, GROUND_TRUTH,
    GOAL, MAP, STATUS, LATENCY, MISSION, TICK, CMD_VEL, GOAL_STATUS,
)  # fmt: skip
