"""The built-in configurations of robots: topics of their drivers, and mounts as in tf."""

from __future__ import annotations

import numpy as np
import pytest
from ros_robots import ROBOTS, builtin_config, builtin_data, transforms_of

from edge.config import parse
from edge.sources.synchronizer import streams_of
from edge.sources.tf import RobotFrames

TOPICS = {
    # depthai_ros_driver (rgb, stereo), rplidar_ros, create3
    "turtlebot4": {
        "camera/rgb": "/oakd/rgb/image_raw",
        "camera/depth": "/oakd/stereo/image_raw",
        "camera/info": "/oakd/rgb/camera_info",
        "lidar/scan": "/scan",
        "odom": "/odom",
    },
    # realsense2_camera, camera_name and camera_namespace as they are by default
    "jetson-realsense": {
        "camera/rgb": "/camera/camera/color/image_raw",
        "camera/depth": "/camera/camera/aligned_depth_to_color/image_raw",
        "camera/info": "/camera/camera/color/camera_info",
        "odom": "/odom",
    },
}


@pytest.mark.parametrize("name", ROBOTS)
def test_topics_are_those_of_the_drivers(name):
    settings = builtin_config(name).ros2
    topics = {**TOPICS[name], "tf": "/tf", "tf_static": "/tf_static"}
    topics["navigate_to_pose"] = "/navigate_to_pose"
    assert {topic: settings.topic(topic) for topic in topics} == topics


@pytest.mark.parametrize("name", ROBOTS)
def test_mounts_agree_with_tf_of_the_robot(name):
    config, body = builtin_config(name), ROBOTS[name]
    frames = RobotFrames(config)
    frames.take(transforms_of(body.tree), static=True)
    mounted = config.sensors.camera.T_base_camera()
    np.testing.assert_allclose(frames.mount_at(body.camera, 0).T, mounted, atol=1e-3)
    assert (config.sensors.lidar is None) == (body.lidar == "")
    if body.lidar:
        mounted = config.sensors.lidar.T_base_mount()
        np.testing.assert_allclose(frames.mount_at(body.lidar, 0).T, mounted, atol=1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_map_uses_depth_by_default(name):
    assert list(streams_of(builtin_config(name))) == ["depth_m", "rgb"]


def test_the_turtlebot_may_map_with_its_lidar():
    config = parse(builtin_data("turtlebot4", mapping={"input": "cloud"}))
    assert list(streams_of(config)) == ["cloud_m", "depth_m", "rgb"]
