"""The section of the robot's ROS 2: names of topics and frames, and the kind of goals."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from edge.config.section import FilePath, Section

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
RosName = Annotated[str, Field(pattern=rf"^(/{_PART})+$", max_length=200)]
Frame = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$", max_length=200)]
DockId = Annotated[str, Field(min_length=1, max_length=100)]
RosTopic = Literal[
    "camera/rgb", "camera/depth", "camera/info", "camera2/rgb", "camera2/depth", "camera2/info",
    "lidar/points", "lidar/scan", "odom", "tf", "tf_static", "goal", "navigate_to_pose",
    "dock_robot", "undock_robot",
    "map", "path", "trajectory", "markers", "detections", "objects", "keepout_mask", "keepout_info",
    "request", "answer", "stop",
]  # fmt: skip

# Our name of a topic or action → its default name in ROS.
DEFAULT_TOPICS: dict[str, str] = {
    "camera/rgb": "/camera/color/image_raw",
    "camera/depth": "/camera/aligned_depth_to_color/image_raw",
    "camera/info": "/camera/color/camera_info",
    "camera2/rgb": "/camera2/color/image_raw",
    "camera2/depth": "/camera2/aligned_depth_to_color/image_raw",
    "camera2/info": "/camera2/color/camera_info",
    "lidar/points": "/points",
    "lidar/scan": "/scan",
    "odom": "/odom",
    "tf": "/tf",
    "tf_static": "/tf_static",
    "goal": "/goal_pose",
    "navigate_to_pose": "/navigate_to_pose",
    "dock_robot": "/dock_robot",
    "undock_robot": "/undock_robot",
    # With a bridge, `/edge/map` would have the same Zenoh key as our own topic `map`.
    "map": "/edge/occupancy",
    "path": "/edge/path",
    "trajectory": "/edge/task_path",
    "markers": "/edge/markers",
    "detections": "/edge/detections",
    "objects": "/edge/objects",
    "keepout_mask": "/edge/keepout_mask",
    "keepout_info": "/edge/keepout_info",
    "request": "/edge/request",
    "answer": "/edge/answer",
    "stop": "/edge/stop",
}


class Ros2AdapterConfig(Section):
    """The program `edge ros2-adapter`, for `via: adapter`.

    Attributes:
        python: interpreter with rclpy and eclipse-zenoh.
        setup: ROS 2's setup file, which is sourced first; null: it was sourced before.
        reliable: topics that are subscribed with reliable QoS, so that no message is lost. All
            others use best effort, which receives from every publisher; reliable does not receive
            from best-effort publishers.
    """

    python: str = "/usr/bin/python3"
    setup: FilePath | None = None
    reliable: tuple[RosTopic, ...] = ()


class Ros2Config(Section):
    """Settings of the source and the sink `ros2`.

    Attributes:
        via: connection to ROS 2. `rmw_zenoh`: the Zenoh router of the graph. For a robot on DDS:
            `bridge` (zenoh-bridge-ros2dds) or `adapter` (`edge ros2-adapter`).
        domain: ROS_DOMAIN_ID. Bridge and adapter take it from their environment.
        node: name of our node.
        map_frame: frame of goals and map. tf transforms odometry of other frames to it.
        base_frame: frame of the robot's base.
        mounts: poses of the sensors on the base: from `tf`, or from `sensors` in this `config`.
        goals: `navigate_to_pose`: the action, whose result is the result of the goal. `topic`: a
            PoseStamped on the topic `goal`, without a result. The goal is reached when the robot
            stops there.
        keepout_filter: publish the zones for Nav2's KeepoutFilter, as `keepout_info` and
            `keepout_mask`; nav2_msgs must be installed.
        detections_frame: tf frame of the first camera's images. If set, its boxes, and objects, are
            published as `detections` and `objects`; vision_msgs must be installed.
        requests: take requests from the topic `request`, and answer on `answer`. Every node of the
            graph may then give orders.
        docks: names of places and the ids of their docks in Nav2's docking server: `{dock: bay_1}`.
            A goal at such a place goes to the action DockRobot instead. UndockRobot comes before
            the next goal elsewhere.
        topics: ROS names that differ from the default: `{camera/rgb: /oakd/rgb/image_raw}`.
        adapter: settings of `edge ros2-adapter`.
    """

    via: Literal["rmw_zenoh", "bridge", "adapter"] = "rmw_zenoh"
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    node: Annotated[str, Field(pattern=rf"^{_PART}$", max_length=60)] = "edge"
    map_frame: Frame = "map"
    base_frame: Frame = "base_link"
    mounts: Literal["tf", "config"] = "tf"
    goals: Literal["navigate_to_pose", "topic"] = "navigate_to_pose"
    keepout_filter: bool = False
    detections_frame: Frame | None = None
    requests: bool = False
    docks: dict[str, DockId] = Field(default_factory=dict, max_length=100)
    topics: dict[RosTopic, RosName] = Field(default_factory=dict)
    adapter: Ros2AdapterConfig = Ros2AdapterConfig()

    @model_validator(mode="after")
    def _check_docks(self) -> Ros2Config:
        if self.docks and (self.via == "adapter" or self.goals == "topic"):
            raise ValueError(
                "docks: needs ros2.goals: navigate_to_pose, and ros2.via: rmw_zenoh or bridge"
            )
        return self

    def topic(self, name: RosTopic) -> str:
        """Return the ROS name of the topic or action `name`."""
        return self.topics.get(name, DEFAULT_TOPICS[name])
