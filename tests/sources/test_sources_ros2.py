"""The source over a real router: a robot's messages, written by `rosbags`, become observations."""

from __future__ import annotations

import itertools
import math
import time

import cv2
import numpy as np
import pytest
from patience import eventually
from ros_messages import STORE, header, pose, to_ros
from ros_router import kept, ours, router, zenoh_settings
from simulated import simulated

from edge.bus.ros2.names import RMW_ZENOH, dialect_of
from edge.bus.ros2.node import Ros2Node
from edge.bus.wire import messages
from edge.geometry import R_BODY_OPTICAL, SE2, CameraModel
from edge.loop.source import missing_inputs
from edge.sources.ros2 import Ros2Source

CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
RGB = np.arange(24 * 32 * 3, dtype=np.uint32).reshape(24, 32, 3).astype(np.uint8)
DEPTH_MM = np.full((24, 32), 1500, np.uint16)
NAMES = {"camera/rgb": "/oakd/rgb/image_raw/compressed", "camera/depth": "/oakd/stereo/image_raw",
         "camera/info": "/oakd/rgb/camera_info"}  # fmt: skip


def transforms(*edges: tuple[str, str, tuple[float, ...], tuple[float, ...]]) -> bytes:
    types = STORE.types
    stamped = [
        types["geometry_msgs/msg/TransformStamped"](
            header(1, parent), child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*moved),
                types["geometry_msgs/msg/Quaternion"](*turned),
            ),
        )
        for parent, child, moved, turned in edges
    ]  # fmt: skip
    return to_ros(types["tf2_msgs/msg/TFMessage"](stamped))


def odometry(stamp_ns: int, at: SE2) -> bytes:
    types = STORE.types
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    moving = types["geometry_msgs/msg/TwistWithCovariance"](
        types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
    )
    there = types["geometry_msgs/msg/PoseWithCovariance"](pose(at), np.zeros(36))
    return to_ros(
        types["nav_msgs/msg/Odometry"](header(stamp_ns, "odom"), "base_link", there, moving)
    )


def jpeg(stamp_ns: int, frame_id: str) -> bytes:
    data = cv2.imencode(".png", RGB[..., ::-1])[1].reshape(-1)
    message = STORE.types["sensor_msgs/msg/CompressedImage"]
    return to_ros(message(header(stamp_ns, frame_id), "rgb8; png compressed bgr8", data))


class Robot:
    """Publishes as a robot does, in the graph of a router."""

    def __init__(self, session, dialect=RMW_ZENOH) -> None:
        self.node = Ros2Node(session, 0, "robot", dialect)
        publish = self.node.publisher
        if dialect.has_tokens:
            self.tf_static = publish("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        else:
            self.tf_static = kept(session, dialect, "/tf_static")
        self.tf = publish("/tf", "tf2_msgs/msg/TFMessage")
        self.odom = publish("/odom", "nav_msgs/msg/Odometry")
        self.rgb = publish(NAMES["camera/rgb"], "sensor_msgs/msg/CompressedImage")
        self.depth = publish(NAMES["camera/depth"], "sensor_msgs/msg/Image")
        self.info = publish(NAMES["camera/info"], "sensor_msgs/msg/CameraInfo")
        self._stamps = itertools.count(10**9, 40_000_000)

    def moor(self) -> None:
        self.tf_static.put(
            transforms(("base_link", "camera", (0.1, 0.0, 0.6), (0, 0, 0, 1)),
                       ("camera", "camera_optical", (0, 0, 0), (-0.5, 0.5, -0.5, 0.5)))
        )  # fmt: skip

    def see(self) -> None:
        """One frame of everything, and odometry on both sides of it."""
        w = math.sqrt(0.5)
        self.tf.put(transforms(("map", "odom", (5.0, 0.0, 0.0), (0.0, 0.0, w, w))))
        stamp_ns = next(self._stamps)
        self.info.put(messages.encode_camera_info(stamp_ns, "camera_optical", CAMERA))
        for ns in (stamp_ns - 10_000_000, stamp_ns + 10_000_000):
            self.odom.put(odometry(ns, SE2(1.0, 0.0, 0.0)))
        self.rgb.put(jpeg(stamp_ns, "camera_optical"))
        self.depth.put(messages.encode_image(stamp_ns, "camera_optical", DEPTH_MM))


@pytest.fixture(scope="module")
def port():
    with router() as port:
        yield port


@pytest.fixture
def robot(port):
    with ours(port) as session:
        robot = Robot(session)
        yield robot
        robot.node.close()


@pytest.fixture
def make(port):
    """Return a function that makes sources with settings of `ros2`."""
    with ours(port) as session:
        made = []

        def source(sections=None, **settings):
            data = {"source": {"kind": "ros2"}, "ros2": {"topics": NAMES, **settings}}
            data = {**data, **(sections or {})}
            config = simulated(data).model_copy(update={"zenoh": zenoh_settings(port)})
            made.append(Ros2Source(config, session))
            return made[-1]

        yield source
        for one in made:
            one.close()


def observed(source: Ros2Source, robot: Robot):
    def look():
        robot.see()
        source.wait(0.05)
        return source.poll()

    return eventually(look)


def test_a_robot_becomes_an_observation(robot, make):
    robot.moor()
    source = make()  # late: static transforms were sent before
    seen = observed(source, robot)
    np.testing.assert_array_equal(seen.rgb, RGB)
    np.testing.assert_allclose(seen.depth_m, 1.5)
    assert seen.camera == CAMERA
    # One metre ahead in `odom`, which is five ahead in `map` and turned to the left.
    np.testing.assert_allclose(seen.T_map_base[:2, 3], [5.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(seen.T_base_camera[:3, :3], R_BODY_OPTICAL, atol=1e-9)
    np.testing.assert_allclose(seen.T_base_camera[:3, 3], [0.1, 0.0, 0.6], atol=1e-9)
    seen.release()
    assert {k: n for k, n in source.counters.items() if n and k == "malformed"} == {}


CLOUD_LEADS = {"mapping": {"input": "cloud"}, "sensors": {"lidar": {}},
               "perception": {"detector": {"kind": "onnx"},
                              "back_projection": "cloud"}}  # fmt: skip


@pytest.mark.parametrize("kind", ["scan", "points"])
def test_a_lidar_has_its_mount_from_tf(robot, make, kind):
    source = make(CLOUD_LEADS, map_frame="odom")
    types = STORE.types
    scan = robot.node.publisher("/scan", "sensor_msgs/msg/LaserScan")
    points = robot.node.publisher("/points", "sensor_msgs/msg/PointCloud2")
    ranges = np.array([1.0, np.inf, 2.0], np.float32)
    expected = np.array([[1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]])
    stamps = itertools.count(5 * 10**9, 100_000_000)

    def look():
        stamp_ns = next(stamps)
        for ns in (stamp_ns - 10_000_000, stamp_ns + 10_000_000):
            robot.odom.put(odometry(ns, SE2(0.0, 0.0, 0.0)))
        robot.tf_static.put(transforms(("base_link", "laser", (0.2, 0, 0.3), (0, 0, 0, 1))))
        if kind == "scan":
            message = types["sensor_msgs/msg/LaserScan"](
                header(stamp_ns, "laser"), 0.0, math.pi, math.pi / 2, 0.0, 0.1, 0.1, 10.0,
                ranges, np.zeros(0, np.float32),
            )  # fmt: skip
            scan.put(to_ros(message))
        else:
            points.put(messages.encode_point_cloud(stamp_ns, "laser", expected))
        # A newer cloud takes the place of one whose odometry is still on its way.
        until_s = time.monotonic() + 0.2
        while (seen := source.poll()) is None and time.monotonic() < until_s:
            source.wait(0.02)
        return seen

    seen = eventually(look)
    hits = np.isfinite(seen.cloud_m).all(axis=1)
    np.testing.assert_allclose(seen.cloud_m[hits], expected, atol=1e-6)
    np.testing.assert_allclose(seen.T_base_lidar[:3, 3], [0.2, 0.0, 0.3])
    seen.release()


def test_an_oversized_message_is_not_decoded(robot, make):
    limits = {"source": {"kind": "ros2", "max_message_mb": 0.001}}
    source = make(limits, map_frame="odom", mounts="config")

    def counted():
        robot.see()
        robot.tf_static.put(bytes(2000))
        source.wait(0.05)
        return source.counters["oversized"] > 3

    eventually(counted)
    assert source.counters["malformed"] == 0


@pytest.mark.parametrize("via", ["bridge", "adapter"])
def test_a_robot_on_dds(port, make, via):
    """Names of zenoh-bridge-ros2dds and the adapter: plain keys, no tokens, no types."""
    with ours(port) as session:
        robot = Robot(session, dialect_of(via, "edge"))
        robot.moor()
        seen = observed(make(via=via), robot)
        np.testing.assert_array_equal(seen.rgb, RGB)
        np.testing.assert_allclose(seen.T_base_camera[:3, 3], [0.1, 0.0, 0.6], atol=1e-9)
        seen.release()
        robot.node.close()


def test_without_tf_every_odometry_message_is_dropped(robot, make):
    source = make(map_frame="nowhere")

    def missed() -> bool:
        robot.see()
        source.wait(0.2)
        assert source.poll() is None
        dropped = "every message on /odom is dropped: no_transform (no transform from 'odom' to "
        return f"{dropped}'nowhere' in tf, which has no 'nowhere')" in missing_inputs(
            source.input_table()
        )

    eventually(missed)


def test_a_topic_of_another_type_is_counted_and_logged(robot, make, caplog):
    source = make(topics={**NAMES, "camera/rgb": "/odom", "odom": "/elsewhere"})

    def told():
        robot.see()
        source.wait(0.05)
        return source.counters["malformed"]

    eventually(told)
    assert "/odom has type nav_msgs/msg/Odometry, expected sensor_msgs/msg/Image or" in caplog.text


def test_no_message_of_a_stranger_is_more_than_counted(robot, make):
    source = make(map_frame="odom", mounts="config")
    strangers = [robot.tf, robot.tf_static, robot.odom, robot.rgb, robot.depth, robot.info]

    def counted():
        for publisher in strangers:
            for payload in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40):
                publisher.put(payload)
        source.wait(0.05)
        assert source.poll() is None
        return source.counters["malformed"] > 10

    eventually(counted)
