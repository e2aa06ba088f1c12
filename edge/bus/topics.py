"""Table of all topics that the service, the simulator and the controller use over Zenoh.

`edge.config.ZenohConfig.key` returns the full key of a topic: below the prefix, renamed as
configured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Qos = Literal["drop", "urgent", "block"]


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic.

    Attributes:
        key: name of the topic, and by default its key below the prefix.
        type: ROS 2 message (CDR), or `json`.
        qos: `drop`: best effort, the newest message wins. `urgent`: higher priority; the publisher
            repeats it until it is acknowledged or outdated. `block`: no message is lost and the
            publisher waits; only for lockstep, where simulated time stands still.
        rate_hz: the usual rate; 0 = on events.
        writer: the process that publishes it. A topic of `simulator` is ground truth, which no
            real robot has.
    """

    key: str
    type: str
    qos: Qos
    rate_hz: float
    writer: Literal["sensors", "simulator", "service", "controller"]


RGB = Topic("camera/rgb", "sensor_msgs/Image", "drop", 30, "sensors")
DEPTH = Topic("camera/depth", "sensor_msgs/Image", "drop", 30, "sensors")
CAMERA_INFO = Topic("camera/info", "sensor_msgs/CameraInfo", "drop", 1, "sensors")
# Of the second camera (`sensors.second_camera`).
RGB2 = Topic("camera2/rgb", "sensor_msgs/Image", "drop", 30, "sensors")
DEPTH2 = Topic("camera2/depth", "sensor_msgs/Image", "drop", 30, "sensors")
CAMERA_INFO2 = Topic("camera2/info", "sensor_msgs/CameraInfo", "drop", 1, "sensors")
CLOUD = Topic("lidar/points", "sensor_msgs/PointCloud2", "drop", 10, "sensors")
SCAN = Topic("lidar/scan", "sensor_msgs/LaserScan", "drop", 10, "sensors")
ODOMETRY = Topic("odom", "nav_msgs/Odometry", "drop", 60, "sensors")

# The robot's true state; the object id of each pixel (uint16, 0 = structure); the labels, that of
# object id i at index i - 1.
GROUND_TRUTH = Topic("sim/ground_truth", "json", "drop", 10, "simulator")
SEGMENTATION = Topic("sim/segmentation", "sensor_msgs/Image", "drop", 30, "simulator")
SEGMENTATION2 = Topic("sim/segmentation2", "sensor_msgs/Image", "drop", 30, "simulator")
LABELS = Topic("sim/labels", "json", "drop", 1, "simulator")

SEGMENTATIONS = SEGMENTATION, SEGMENTATION2  # by `Observation.camera_index`

GOAL = Topic("goal", "geometry_msgs/PoseStamped", "urgent", 0, "service")
MAP = Topic("map", "nav_msgs/OccupancyGrid", "drop", 2, "service")
STATUS = Topic("status", "json", "drop", 1, "service")
LATENCY = Topic("latency", "json", "drop", 1, "service")
MISSION = Topic("mission", "json", "urgent", 0, "service")
TRAJECTORY = Topic("trajectory", "nav_msgs/Path", "drop", 0, "service")
TICK = Topic("tick", "json", "block", 0, "service")

CMD_VEL = Topic("cmd_vel", "geometry_msgs/TwistStamped", "drop", 20, "controller")
GOAL_STATUS = Topic("goal_status", "json", "urgent", 0, "controller")

# Not topics but queryables: requests about the mission, the models, and places and zones, JSON both
# ways (see `edge.loop.requests.handlers`, `edge.loop.requests.site_requests`).
MISSION_REQUEST = "mission/request"
MODELS_REQUEST = "models/request"
SITE_REQUEST = "site/request"
MEMORY_REQUEST = "memory/request"
# To stop the robot and to release it (see `edge.bus.stop`): two keys, so that access rules can let
# everybody stop and few release.
STOP_REQUEST = "stop/request"
RELEASE_REQUEST = "release/request"
# Requests of agents, and of the people who confirm them (see `edge.loop.requests.agent_requests`).
AGENT_REQUEST = "agent/request"
CONFIRM_REQUEST = "confirm/request"
REQUESTS = (
    MISSION_REQUEST, MODELS_REQUEST, SITE_REQUEST, MEMORY_REQUEST, STOP_REQUEST, RELEASE_REQUEST,
    AGENT_REQUEST, CONFIRM_REQUEST,
)  # fmt: skip

# Not a topic: the service's liveliness token is below this key (see `edge.bus.presence`).
ALIVE = "alive"

ALL: tuple[Topic, ...] = (
    RGB, DEPTH, CAMERA_INFO, RGB2, DEPTH2, CAMERA_INFO2, CLOUD, SCAN, ODOMETRY,
    GROUND_TRUTH, SEGMENTATION, SEGMENTATION2, LABELS,
    GOAL, MAP, STATUS, LATENCY, MISSION, TRAJECTORY, TICK, CMD_VEL, GOAL_STATUS,
)  # fmt: skip

PLAYED = tuple(topic for topic in ALL if topic.writer in ("sensors", "simulator"))
"""Topics that a robot, or the simulator in its place, publishes."""
