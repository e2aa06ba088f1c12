"""The robots of the built-in configurations: their frames, as their makers publish them.

Each edge is (parent, child, metres, roll, pitch and yaw in degrees).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ros_messages import STORE, header, to_ros

from edge.config import Config, parse
from edge.config.yaml_text import read_yaml
from edge.geometry import SE2, quaternion_of, se3
from edge.host import resources

_OPTICAL = (-90.0, 0.0, -90.0)

Edge = tuple[str, str, tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Body:
    """Simulated body of a ROS robot.

    Attributes:
        camera, lidar: the frames that its messages name.
        tree: transforms on `/tf_static`.
    """

    camera: str
    tree: tuple[Edge, ...]
    lidar: str = ""


ROBOTS = {
    # turtlebot4_description/urdf/standard/turtlebot4.urdf.xacro and sensors/oakd.urdf.xacro;
    # turtlebot4_bringup/launch/rplidar.launch.py; irobot_create_description/urdf/create3.urdf.xacro
    "turtlebot4": Body(
        "oakd_rgb_camera_optical_frame",
        (
            ("base_link", "shell_link", (0.0, 0.0, 0.03 + 0.0642), (0.0, 0.0, 0.0)),
            ("shell_link", "rplidar_link", (-0.04, 0.0, 0.098715), (0.0, 0.0, 90.0)),
            ("shell_link", "oakd_camera_bracket", (-0.118, 0.0, 0.05257), (0.0, 0.0, 0.0)),
            ("oakd_camera_bracket", "oakd_link", (0.0584, 0.0, 0.09676), (0.0, 0.0, 0.0)),
            ("oakd_link", "oakd_rgb_camera_frame", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            ("oakd_rgb_camera_frame", "oakd_rgb_camera_optical_frame", (0.0, 0.0, 0.0), _OPTICAL),
        ),
        lidar="rplidar_link",
    ),
    # realsense2_camera/src/tfs.cpp, d435_cam_depth_to_color_offset; base_link → camera_link is set
    # by the robot's builder.
    "jetson-realsense": Body(
        "camera_color_optical_frame",
        (
            ("base_link", "camera_link", (0.1, 0.0, 0.3), (0.0, 0.0, 0.0)),
            ("camera_link", "camera_color_frame", (0.0, 0.015, 0.0), (0.0, 0.0, 0.0)),
            ("camera_color_frame", "camera_color_optical_frame", (0.0, 0.0, 0.0), _OPTICAL),
        ),
    ),
}

ODOM_IN_MAP = SE2(1.0, -0.5, 0.0)
"""Pose of the odometry's frame in `map`, from localization."""


def builtin_data(name: str, **sections: Any) -> dict[str, Any]:
    """Return a built-in configuration's data with these keys laid over its sections."""
    data = read_yaml(resources.find_config(name))
    for section, changes in sections.items():
        before = data.get(section)
        data[section] = {**before, **changes} if isinstance(before, dict) else changes
    return data


def builtin_config(name: str) -> Config:
    return parse(builtin_data(name), name)


def transforms_of(tree: tuple[Edge, ...]) -> bytes:
    """Return its tf2_msgs/TFMessage, made by `rosbags`."""
    types, stamped = STORE.types, []
    for parent, child, moved_m, turned_deg in tree:
        quaternion = quaternion_of(se3(*moved_m, *map(math.radians, turned_deg)))
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*moved_m),
            types["geometry_msgs/msg/Quaternion"](*quaternion),
        )
        kind = types["geometry_msgs/msg/TransformStamped"]
        stamped.append(kind(header(1, parent), child, transform))
    return to_ros(types["tf2_msgs/msg/TFMessage"](stamped))


LOCALIZED = transforms_of((("map", "odom", (ODOM_IN_MAP.x_m, ODOM_IN_MAP.y_m, 0.0), (0, 0, 0)),))
