"""Round trips, `rosbags` as the oracle in both directions, and false payloads."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from edge.bus.wire import DecodeError, messages
from edge.geometry import SE2, CameraModel, Grid, se3

STORE = get_typestore(Stores.ROS2_HUMBLE)
HUGE = 2**32 - 1
CAMERA = CameraModel(320, 256, 208.5, 208.25, 159.5, 127.5)
STAMP_NS = 1_790_000_000_123_456_789
POSE = se3(1.0, -2.0, 0.5, 0.1, -0.2, 3.0)


def from_ros(payload: bytes, name: str):
    return STORE.deserialize_cdr(payload, name)


def to_ros(message) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def grid() -> np.ndarray:
    return np.array([[-1, 0, 100], [0, 50, -1]], np.int8)


PAYLOADS = {
    "sensor_msgs/msg/Image": messages.encode_image(STAMP_NS, "cam", np.ones((2, 3, 3), np.uint8)),
    "sensor_msgs/msg/CameraInfo": messages.encode_camera_info(STAMP_NS, "camera", CAMERA),
    "sensor_msgs/msg/PointCloud2": messages.encode_point_cloud(
        STAMP_NS, "lidar", np.arange(12, dtype=np.float32).reshape(4, 3)
    ),
    "sensor_msgs/msg/LaserScan": messages.encode_laser_scan(
        STAMP_NS, "lidar", -1.5, 0.5, 10.0, np.array([1, 2, np.inf], np.float32)
    ),
    "nav_msgs/msg/Odometry": messages.encode_odometry(STAMP_NS, POSE, 0.3, -0.2),
    "geometry_msgs/msg/PoseStamped": messages.encode_pose_stamped(STAMP_NS, SE2(1.0, 2.0, -3.0)),
    "geometry_msgs/msg/TwistStamped": messages.encode_twist_stamped(STAMP_NS, 0.5, -0.1),
    "nav_msgs/msg/OccupancyGrid": messages.encode_occupancy_grid(
        STAMP_NS, Grid(grid(), (-1.0, 2.0), 0.05)
    ),
}


def decode_image(payload: bytes):
    header = messages.decode_image_header(payload)
    out = np.zeros((header.height, header.width, 3), np.uint8)
    messages.decode_image_into(payload, header, out)
    return header, out


DECODERS = {
    "sensor_msgs/msg/Image": decode_image,
    "sensor_msgs/msg/CameraInfo": messages.decode_camera_info,
    "sensor_msgs/msg/PointCloud2": lambda p: messages.decode_point_cloud_into(
        p, np.zeros((64, 3), np.float32)
    ),
    "sensor_msgs/msg/LaserScan": lambda p: messages.decode_scan_points_into(
        p, np.zeros((64, 3), np.float32)
    ),
    "nav_msgs/msg/Odometry": messages.decode_odometry,
    "geometry_msgs/msg/PoseStamped": messages.decode_pose_stamped,
    "geometry_msgs/msg/TwistStamped": messages.decode_twist_stamped,
    "nav_msgs/msg/OccupancyGrid": messages.decode_occupancy_grid,
}


# -- the oracle ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PAYLOADS)
def test_ros_reads_our_messages_and_writes_the_same_bytes(name):
    message = from_ros(PAYLOADS[name], name)
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == STAMP_NS
    assert to_ros(message) == PAYLOADS[name]


def test_ros_reads_the_same_values():
    image = from_ros(PAYLOADS["sensor_msgs/msg/Image"], "sensor_msgs/msg/Image")
    assert (image.height, image.width, image.encoding, image.step) == (2, 3, "rgb8", 9)
    assert image.data.tolist() == [1] * 18
    info = from_ros(PAYLOADS["sensor_msgs/msg/CameraInfo"], "sensor_msgs/msg/CameraInfo")
    assert (info.k[0], info.k[4], info.k[2], info.k[5]) == (208.5, 208.25, 159.5, 127.5)
    scan = from_ros(PAYLOADS["sensor_msgs/msg/LaserScan"], "sensor_msgs/msg/LaserScan")
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1.5, -0.5, 10.0)
    odometry = from_ros(PAYLOADS["nav_msgs/msg/Odometry"], "nav_msgs/msg/Odometry")
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    assert (odometry.twist.twist.linear.x, odometry.twist.twist.angular.z) == (0.3, -0.2)
    ros_grid = from_ros(PAYLOADS["nav_msgs/msg/OccupancyGrid"], "nav_msgs/msg/OccupancyGrid")
    assert (ros_grid.info.width, ros_grid.info.height) == (3, 2)
    assert ros_grid.data.tolist() == [-1, 0, 100, 0, 50, -1]
    assert ros_grid.info.origin.position.x == -1.0


def ros_image(encoding: str, height: int, width: int, step: int, data: bytes, big_endian=0):
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 6), "camera")
    array = np.frombuffer(data, np.uint8)
    return to_ros(
        types["sensor_msgs/msg/Image"](header, height, width, encoding, big_endian, step, array)
    )


@pytest.mark.parametrize(
    ("encoding", "pixels", "rgb"),
    [
        ("rgb8", b"\x01\x02\x03\x04\x05\x06", [[1, 2, 3], [4, 5, 6]]),
        ("bgr8", b"\x01\x02\x03\x04\x05\x06", [[3, 2, 1], [6, 5, 4]]),
        ("rgba8", b"\x01\x02\x03\xff\x04\x05\x06\xff", [[1, 2, 3], [4, 5, 6]]),
        ("bgra8", b"\x01\x02\x03\xff\x04\x05\x06\xff", [[3, 2, 1], [6, 5, 4]]),
        ("mono8", b"\x07\x09", [[7, 7, 7], [9, 9, 9]]),
        ("8UC3", b"\x01\x02\x03\x04\x05\x06", [[3, 2, 1], [6, 5, 4]]),
        ("8UC1", b"\x07\x09", [[7, 7, 7], [9, 9, 9]]),
        ("yuv422", bytes((90, 81, 240, 81)), [[254, 0, 0], [254, 0, 0]]),
        ("uyvy", bytes((90, 81, 240, 81)), [[254, 0, 0], [254, 0, 0]]),
        ("yuv422_yuy2", bytes((81, 90, 81, 240)), [[254, 0, 0], [254, 0, 0]]),
        ("yuyv", bytes((81, 90, 81, 240)), [[254, 0, 0], [254, 0, 0]]),
    ],
)
@pytest.mark.parametrize("padding", [0, 1, 5])
def test_every_colour_encoding_becomes_rgb(encoding, pixels, rgb, padding):
    row = pixels + b"\xee" * padding
    payload = ros_image(encoding, 2, 2, len(row), row * 2)
    header, out = decode_image(payload)
    assert (header.stamp_ns, header.frame_id) == (5_000_000_006, "camera")
    assert out.tolist() == [rgb, rgb]


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_pattern_becomes_rgb(pattern):
    colour = {"r": 200, "g": 100, "b": 50}
    square = np.array([colour[c] for c in pattern], np.uint8).reshape(2, 2)
    payload = ros_image(f"bayer_{pattern}8", 6, 8, 8, np.tile(square, (3, 4)).tobytes())
    _, out = decode_image(payload)
    assert (out == (200, 100, 50)).all()


def test_an_odd_number_of_pixels_has_no_pairs():
    with pytest.raises(DecodeError, match="width must be even"):
        messages.decode_image_header(ros_image("yuyv", 1, 3, 6, bytes(6)))


@pytest.mark.parametrize("big_endian", [0, 1])
@pytest.mark.parametrize("padding", [0, 1, 3])
def test_depth_in_millimetres_and_in_metres(big_endian, padding):
    order = ">" if big_endian else "<"
    out = np.zeros((2, 3), np.float32)
    for encoding, code, values in (
        ("16UC1", "3H", (0, 1500, 63999)),
        ("32FC1", "3f", (0.0, 1.5, math.nan)),
    ):
        row = struct.pack(order + code, *values) + b"\xee" * padding
        payload = ros_image(encoding, 2, 3, len(row), row * 2, big_endian)
        messages.decode_image_into(payload, messages.decode_image_header(payload), out)
        expected = np.array(values, np.float32) * (0.001 if encoding == "16UC1" else 1.0)
        np.testing.assert_allclose(out, [expected] * 2, rtol=1e-6)


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize(("unit_m", "metres"), [(None, 0.001), (0.0002, 0.0002), (0.01, 0.01)])
@pytest.mark.parametrize("big_endian", [False, True])
def test_invalid_depth_integers_are_no_return(encoding, unit_m, metres, big_endian):
    steps = np.array([[0, 1, 500], [63_999, 64_001, 65_535]], ">u2" if big_endian else "<u2")
    payload = ros_image(encoding, 2, 3, 6, steps.tobytes(), big_endian)
    out = np.full((2, 3), 9.0, np.float32)
    messages.decode_image_into(payload, messages.decode_image_header(payload), out, unit_m)
    expected = np.array([[0, 1, 500], [63_999, 0, 0]]) * metres
    np.testing.assert_allclose(out, expected, rtol=1e-6)


def test_depth_of_floats_has_a_unit_too():
    depth = np.array([[np.nan, np.inf, 700.0, 65_535.0]], np.float32)
    payload = messages.encode_image(1, "camera", depth)
    out = np.zeros_like(depth)
    messages.decode_image_into(payload, messages.decode_image_header(payload), out, 0.001)
    np.testing.assert_allclose(out, 0.001 * depth, rtol=1e-6)


def ros_cloud(names: str, step: int, points: np.ndarray, big_endian=False, height=1) -> bytes:
    """`names`: one letter a float32 field, in the order of their offsets, from offset 4 on."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 6), "lidar")
    fields = [
        types["sensor_msgs/msg/PointField"](name, 4 + 4 * i, 7, 1) for i, name in enumerate(names)
    ]
    data = np.full((len(points), step), 0xEE, np.uint8)
    for i, name in enumerate(names):
        if name in "xyz":
            column = points[:, "xyz".index(name)].astype(">f4" if big_endian else "<f4")
            data[:, 4 + 4 * i : 8 + 4 * i] = column.reshape(-1, 1).view(np.uint8)
    width = len(points) // height
    return to_ros(
        types["sensor_msgs/msg/PointCloud2"](
            header, height, width, fields, big_endian, step, width * step, data.reshape(-1), True
        )
    )


STEPS = 0, 1, 8, 96, HUGE
"""Values that drivers send, such as the number of points, or the size of all data."""


def with_steps(payload: bytes, point_step: int, row_step: int, size: int = 128) -> bytes:
    """Return a cloud of 2 rows of 4 points of 16 bytes, with other steps in its header."""
    said = struct.pack("<III", 16, 64, 128)
    assert payload.count(said) == 1
    return payload.replace(said, struct.pack("<III", point_step, row_step, size))


@pytest.mark.parametrize("said", [(16, 0, 112), (16, 65, 127), (24, 64, 128)])
def test_a_cloud_with_steps_that_mismatch_its_data_is_refused(said):
    payload = with_steps(ros_cloud("xyz", 16, np.zeros((8, 3)), height=2), *said)
    with pytest.raises(DecodeError, match=rf"row_step {said[1]} do not fit {said[2]} bytes"):
        messages.decode_point_cloud_into(payload, np.zeros((8, 3), np.float32))


@pytest.mark.parametrize("step", STEPS)
def test_an_image_without_padding_needs_no_step(step):
    image = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    payload = ros_image("rgb8", 2, 3, step, image.tobytes())
    out = np.zeros_like(image)
    messages.decode_image_into(payload, messages.decode_image_header(payload), out)
    np.testing.assert_array_equal(out, image)
    with pytest.raises(DecodeError, match=f"step {step} does not fit 17 bytes"):
        messages.decode_image_header(ros_image("rgb8", 2, 3, step, bytes(17)))


@pytest.mark.parametrize(
    ("names", "step", "big_endian", "height"),
    [("xyz", 16, False, 1), ("zyx", 17, False, 2), ("ixryz", 32, True, 1), ("xyz", 23, True, 4)],
)
def test_a_cloud_of_any_layout(names, step, big_endian, height):
    points = np.arange(24, dtype=np.float32).reshape(8, 3)
    out = np.zeros((10, 3), np.float32)
    payload = ros_cloud(names, step, points, big_endian, height)
    for whole in (False, True):
        out[:] = 9.0
        assert messages.decode_point_cloud_into(payload, out, whole) == 8
        np.testing.assert_array_equal(out[:8], points)


def test_points_that_are_not_finite_are_left_out():
    points = np.arange(18, dtype=np.float32).reshape(6, 3)
    points[0, 0], points[3, 1], points[5, 2] = np.nan, np.inf, -np.inf
    out = np.zeros((6, 3), np.float32)
    payload = messages.encode_point_cloud(1, "l", points)
    assert messages.decode_point_cloud_into(payload, out) == 3
    np.testing.assert_array_equal(out[:3], points[[1, 2, 4]])
    assert messages.decode_point_cloud_into(payload, out, keep_invalid=True) == 6
    np.testing.assert_array_equal(out, points)


@pytest.mark.parametrize("range_max_m", [10.0, math.inf])
def test_a_beam_without_a_return_is_free_to_its_range(range_max_m):
    nothing, no_measurement = [math.inf, range_max_m, 2 * range_max_m], [math.nan, -math.inf, -1.0]
    ranges = np.array([*nothing, *no_measurement, 2.0], np.float32)
    payload = messages.encode_laser_scan(1, "lidar", 0.0, 0.0, range_max_m, ranges)
    out = np.zeros((7, 3), np.float32)
    assert messages.decode_scan_points_into(payload, out, free=True) == 4
    end_m = min(range_max_m, 5e5)
    assert out[:4].tolist() == [[end_m, 0, math.inf]] * 3 + [[2, 0, 0]]


def test_camera_info_of_a_rectified_image_and_without_projection():
    name = "sensor_msgs/msg/CameraInfo"
    info = from_ros(PAYLOADS[name], name)
    info.p = np.array([300.0, *info.p[1:]])
    assert messages.decode_camera_info(to_ros(info)).camera.fx_px == 300.0
    info.p = np.zeros(12)
    assert messages.decode_camera_info(to_ros(info)).camera == CAMERA


INFO = "sensor_msgs/msg/CameraInfo"
BENT = (-0.35, 0.14, 0.0007, -0.0003, 0.0)


def camera_info(**fields: object) -> messages.CameraCalibration:
    """`CAMERA` as decoded, with other fields; numbers of binning and roi as tuples."""
    info = from_ros(PAYLOADS[INFO], INFO)
    for name, value in fields.items():
        if name == "binning":
            info.binning_x, info.binning_y = value
        elif name == "roi":
            roi = info.roi
            roi.x_offset, roi.y_offset, roi.width, roi.height = value
        else:
            old = getattr(info, name)
            setattr(info, name, value if isinstance(old, str) else np.array(value, np.float64))
    return messages.decode_camera_info(to_ros(info))


@pytest.mark.parametrize(
    ("binning", "roi", "expected"),
    [
        ((1, 1), (0, 0, 64, 48), (64, 48, 60.0, 62.0, 32.0, 23.0)),
        ((2, 2), (0, 0, 0, 0), (32, 24, 30.0, 31.0, 16.0, 11.5)),
        ((2, 1), (0, 0, 0, 0), (32, 48, 30.0, 62.0, 16.0, 23.0)),
        ((0, 0), (8, 4, 40, 30), (40, 30, 60.0, 62.0, 24.0, 19.0)),
        ((2, 2), (8, 4, 40, 30), (20, 15, 30.0, 31.0, 12.0, 9.5)),
    ],
)
def test_binning_and_roi_change_the_camera_model(binning, roi, expected):
    k = [60.0, 0, 32.0, 0, 62.0, 23.0, 0, 0, 1]
    info = from_ros(PAYLOADS[INFO], INFO)
    info.width, info.height = 64, 48
    info.k, info.p, info.d = np.array(k), np.zeros(12), np.array(BENT)
    info.binning_x, info.binning_y = binning
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = roi
    told = messages.decode_camera_info(to_ros(info))
    assert told.camera == told.lens.camera == CameraModel(*expected)
    assert bool(told.cut) == (expected[:2] != (64, 48))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"d": (math.nan,)}, "distortion holds NaN"),
        ({"d": (0.1,) * 65}, "65 coefficients"),
        ({"d": BENT, "k": (0.0,) * 9}, "focal lengths 0, 0"),
        ({"roi": (1, 0, CAMERA.width_px, 1)}, "outside the image"),
        ({"binning": (HUGE, 1)}, "not a camera: 0x"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(fields, says):
    with pytest.raises(DecodeError, match=says):
        camera_info(**fields)


# -- false payloads --------------------------------------------------------------------------


@pytest.mark.parametrize("name", PAYLOADS)
def test_every_truncation_is_an_error_in_one_line(name):
    payload = PAYLOADS[name]
    tail = {"sensor_msgs/msg/PointCloud2": 1}.get(name, 0)  # `is_dense` is not read
    for size in range(len(payload) - tail):
        with pytest.raises(DecodeError) as caught:
            DECODERS[name](payload[:size])
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "payload",
    [
        pytest.param(ros_image("rgb8", HUGE, HUGE, HUGE, b"abc"), id="image"),
        pytest.param(ros_image("rgb8", 1, 100, 3, b"abc"), id="step below the width"),
        pytest.param(ros_image("jpeg", 1, 1, 3, b"abc"), id="unknown encoding"),
    ],
)
def test_sizes_are_checked_before_memory_is_allocated(payload):
    with pytest.raises(DecodeError):
        messages.decode_image_header(payload)


def projection(i: int, value: float) -> Callable[[object], None]:
    """Set one number of CameraInfo's projection matrix P."""

    def change(info) -> None:
        info.p = info.p.copy()
        info.p[i] = value

    return change


def zero_rotation(odometry) -> None:
    odometry.pose.pose.orientation = type(odometry.pose.pose.orientation)(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("nav_msgs/msg/Odometry", lambda m: setattr(m.pose.pose.position, "x", math.nan), "NaN"),
        ("nav_msgs/msg/Odometry", zero_rotation, "not a rotation"),
        (
            "nav_msgs/msg/Odometry",
            lambda m: setattr(m.header.stamp, "nanosec", 10**9),
            "nanosec 10",
        ),
        ("nav_msgs/msg/Odometry", lambda m: setattr(m.pose.pose.position, "z", 1e300), "too far"),
        ("geometry_msgs/msg/PoseStamped", lambda m: setattr(m.pose.position, "y", -1e6), "too far"),
        ("nav_msgs/msg/OccupancyGrid", lambda m: setattr(m.info.origin.position, "x", 1e30), "far"),
        ("sensor_msgs/msg/CameraInfo", lambda m: setattr(m, "width", 0), "not a camera"),
        ("sensor_msgs/msg/CameraInfo", lambda m: setattr(m, "height", HUGE), "not a camera"),
        ("sensor_msgs/msg/CameraInfo", projection(0, 1e300), "focal lengths 1e.300"),
        ("sensor_msgs/msg/CameraInfo", projection(5, 1e-300), "focal lengths"),
        ("sensor_msgs/msg/CameraInfo", projection(2, math.nan), "principal point"),
        ("sensor_msgs/msg/CameraInfo", projection(6, -1e30), "principal point"),
        ("nav_msgs/msg/OccupancyGrid", lambda m: setattr(m.info, "resolution", 0.0), "resolution"),
        ("nav_msgs/msg/OccupancyGrid", lambda m: setattr(m.info, "width", 4), "6 cells for 4x2"),
    ],
)
def test_values_that_cannot_be(name, change, text):
    message = from_ros(PAYLOADS[name], name)
    change(message)
    with pytest.raises(DecodeError, match=text):
        DECODERS[name](to_ros(message))


@pytest.mark.parametrize(("part", "axis"), [("linear", "x"), ("linear", "y"), ("angular", "z")])
def test_odometry_with_an_unknown_speed_has_its_pose(part, axis):
    message = from_ros(PAYLOADS["nav_msgs/msg/Odometry"], "nav_msgs/msg/Odometry")
    setattr(getattr(message.twist.twist, part), axis, math.nan)
    np.testing.assert_allclose(messages.decode_odometry(to_ros(message)).T_map_base, POSE)


def test_an_image_of_another_shape_is_refused():
    payload = PAYLOADS["sensor_msgs/msg/Image"]
    header = messages.decode_image_header(payload)
    with pytest.raises(DecodeError, match="3x2, expected 2x2"):
        messages.decode_image_into(payload, header, np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(DecodeError, match="is rgb8, but float32"):
        messages.decode_image_into(payload, header, np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match="no image encoding"):
        messages.encode_image(1, "camera", np.zeros((2, 3, 4), np.uint8))
