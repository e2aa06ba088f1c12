"""The robot's ROS 2 graph: what its topics and frames are called, and how it takes goals."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from edge.config.section import Section

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
RosName = Annotated[str, Field(pattern=rf"^(/{_PART})+$", max_length=200)]
Frame = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$", max_length=200)]
RosTopic = Literal[
    "camera/rgb", "camera/depth", "camera/info", "lidar/points", "lidar/scan", "odom", "tf",
    "tf_static", "goal", "navigate_to_pose", "map", "path", "trajectory", "markers",
]  # fmt: skip

DEFAULT_TOPICS: dict[str, str] = {
    "camera/rgb": "/camera/color/image_raw",
    "camera/depth": "/camera/aligned_depth_to_color/image_raw",
    "camera/info": "/camera/color/camera_info",
    "lidar/points": "/points",
    "lidar/scan": "/scan",
    "odom": "/odom",
    "tf": "/tf",
    "tf_static": "/tf_static",
    "goal": "/goal_pose",
    "navigate_to_pose": "/navigate_to_pose",
    # Beside a bridge `/edge/map` would be the key of our own `map`, and so on.
    "map": "/edge/occupancy",
    "path": "/edge/path",
    "trajectory": "/edge/task_path",
    "markers": "/edge/markers",
}


class Adapter(Section):
    """`edge ros2-adapter`, for `via: adapter`.

    `python` has rclpy and eclipse-zenoh; `setup` is sourced first, where ROS 2's setup file was not
    sourced before. Best effort hears reliable publishers too; `reliable` names the topics of which
    no message may be lost on the way from DDS, and which no best-effort publisher sends.
    """

    python: str = "/usr/bin/python3"
    setup: str | None = None
    reliable: tuple[RosTopic, ...] = ()


class Ros2(Section):
    """For the source and the sink `ros2`.

    `via`: who is spoken to: the router of a graph on `rmw_zenoh`, or, beside a robot on DDS, the
    `bridge` zenoh-bridge-ros2dds or our own `adapter`.
    `domain` is ROS_DOMAIN_ID; the bridge and the adapter have it from their environment.
    `topics` gives what is not called as usual its ROS name: `{camera/rgb: /oakd/rgb/image_raw}`.
    `map_frame` is where goals and the map are; odometry in another frame is taken there by tf.
    `mounts`: where the sensors sit, by `tf`, or as `sensors` of this configuration says.
    `goals`: the action NavigateToPose, whose result is the goal's answer, or a PoseStamped on
    the topic `goal`, which nobody answers: a goal is then reached when the robot stops there.
    """

    via: Literal["rmw_zenoh", "bridge", "adapter"] = "rmw_zenoh"
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    node: Annotated[str, Field(pattern=rf"^{_PART}$", max_length=60)] = "edge"
    map_frame: Frame = "map"
    base_frame: Frame = "base_link"
    mounts: Literal["tf", "config"] = "tf"
    goals: Literal["navigate_to_pose", "topic"] = "navigate_to_pose"
    topics: dict[RosTopic, RosName] = Field(default_factory=dict)
    adapter: Adapter = Adapter()

    def topic(self, name: RosTopic) -> str:
        """What ROS calls the topic, or the action, that this project calls `name`."""
        return self.topics.get(name, DEFAULT_TOPICS[name])
