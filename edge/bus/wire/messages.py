"""Encoders and decoders of ROS 2 messages (CDR little-endian).

Decoders raise `DecodeError` with one line for a malformed payload. Sizes are checked against the
payload first, so a wrong size allocates nothing. Layouts: sensor_msgs, nav_msgs and geometry_msgs
of ROS 2 Humble to Jazzy (they are equal). Images and clouds are in `images`, `compressed` and
`clouds`, tf and paths in `transforms`, Nav2's action in `navigation`, RViz markers in `markers`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from edge.bus.wire.cdr import STAMP, U32, CdrReader, CdrWriter, DecodeError
from edge.bus.wire.clouds import (
    LaserScan,
    decode_laser_scan,
    decode_point_cloud_into,
    decode_scan_points_into,
    encode_laser_scan,
    encode_point_cloud,
)
from edge.bus.wire.images import ImageHeader, decode_image_header, decode_image_into, encode_image
from edge.geometry import (
    FARTHEST_M,
    SE2,
    CameraModel,
    Grid,
    Lens,
    quaternion_of,
    se2_of,
    se3_from_quaternion,
)
from edge.text import one_line

MAP_FRAME = "map"
BASE_FRAME = "base_link"

# Sensors of a robot at this distance are still inside the map's limit.
_FARTHEST_M = 0.9 * FARTHEST_M
_POSE = struct.Struct("<7d")  # x, y, z; quaternion x, y, z, w
_TWIST = struct.Struct("<6d")  # linear x, y, z; angular x, y, z
_COVARIANCE = struct.Struct("<36d")
# sensor_msgs/CameraInfo: matrix K of the raw and P of the rectified camera, row by row.
_K = struct.Struct("<9d")
_P = struct.Struct("<12d")
_HEIGHT_WIDTH = struct.Struct("<II")
_MAX_COEFFICIENTS = 64  # of the distortion
_ROI = struct.Struct("<IIIIIIB")  # binning x, y; region x, y, height, width; do_rectify
_GRID_INFO = struct.Struct("<fII")  # resolution, width, height
_IDENTITY_3 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def peek_stamp_ns(payload: bytes) -> int:
    """Return the stamp of any message that begins with a std_msgs/Header."""
    return CdrReader(payload).stamp_ns()


def peek_header(payload: bytes) -> tuple[int, str]:
    """Return (stamp_ns, frame_id) of any message that begins with a std_msgs/Header."""
    return CdrReader(payload).header()


def _finite(values: tuple[float, ...], what: str) -> tuple[float, ...]:
    """Return the values; raise DecodeError, which names them `what`, for NaN or inf."""
    if not all(map(math.isfinite, values)):
        raise DecodeError(f"{what} holds NaN or inf")
    return values


def write_pose(writer: CdrWriter, T: np.ndarray) -> CdrWriter:
    """Write a (4, 4) transform as geometry_msgs/Pose."""
    return writer.write(_POSE, 8, *T[:3, 3], *quaternion_of(T))


def read_pose(reader: CdrReader) -> np.ndarray:
    """Read a geometry_msgs/Pose as a (4, 4) transform."""
    values = _finite(reader.read(_POSE, 8), "pose")
    if max(map(abs, values[:3])) >= _FARTHEST_M:
        raise DecodeError(
            f"pose ({values[0]:g}, {values[1]:g}, {values[2]:g}) m is too far from the origin of "
            "`map` for float32: use a local frame"
        )
    try:
        return se3_from_quaternion(values[:3], values[3:])
    except ValueError as error:
        raise DecodeError(str(error)) from None


@dataclass(frozen=True, slots=True, eq=False)
class OdometryMessage:
    """nav_msgs/Odometry: pose of the base in `map`, and twist in the base frame.

    Attributes:
        T_map_base: (4, 4) float64 pose.
        v_mps: forward speed.
        w_radps: turn rate, left positive.
        frame_id: the message's own name of the first frame, which may not be `map`.
        child_frame_id: the message's own name of the second frame, which may not be the base.
    """

    stamp_ns: int
    T_map_base: np.ndarray
    v_mps: float
    w_radps: float
    frame_id: str = MAP_FRAME
    child_frame_id: str = BASE_FRAME


def encode_odometry(stamp_ns: int, T_map_base: np.ndarray, v_mps: float, w_radps: float) -> bytes:
    """Encode nav_msgs/Odometry with zero covariances (unknown)."""
    writer = CdrWriter().header(stamp_ns, MAP_FRAME).string(BASE_FRAME)
    write_pose(writer, T_map_base).write(_COVARIANCE, 8, *(0.0,) * 36)
    writer.write(_TWIST, 8, v_mps, 0.0, 0.0, 0.0, 0.0, w_radps)
    return writer.write(_COVARIANCE, 8, *(0.0,) * 36).bytes()


def decode_odometry(payload: bytes) -> OdometryMessage:
    """Decode nav_msgs/Odometry; of the twist, only forward speed and turn rate.

    These may be NaN: some drivers leave unknown speeds so, with a good pose.
    """
    reader = CdrReader(payload)
    stamp_ns, frame_id = reader.header()
    child_frame_id = reader.string()
    T = read_pose(reader)
    reader.skip(_COVARIANCE.size, 8)
    twist = reader.read(_TWIST, 8)
    reader.skip(_COVARIANCE.size, 8)
    return OdometryMessage(stamp_ns, T, twist[0], twist[5], frame_id, child_frame_id)


def encode_pose_stamped(stamp_ns: int, pose: SE2, frame_id: str = MAP_FRAME) -> bytes:
    """Encode geometry_msgs/PoseStamped with z = 0."""
    return write_pose(CdrWriter().header(stamp_ns, frame_id), pose.matrix()).bytes()


def decode_pose_stamped(payload: bytes) -> tuple[int, SE2]:
    """Decode geometry_msgs/PoseStamped as (stamp_ns, planar pose)."""
    reader = CdrReader(payload)
    stamp_ns, _ = reader.header()
    return stamp_ns, se2_of(read_pose(reader))


def encode_twist_stamped(stamp_ns: int, v_mps: float, w_radps: float) -> bytes:
    """Encode geometry_msgs/TwistStamped in the base frame."""
    writer = CdrWriter().header(stamp_ns, BASE_FRAME)
    return writer.write(_TWIST, 8, v_mps, 0.0, 0.0, 0.0, 0.0, w_radps).bytes()


def decode_twist_stamped(payload: bytes) -> tuple[int, float, float]:
    """Decode geometry_msgs/TwistStamped as (stamp_ns, forward m/s, turn rad/s)."""
    reader = CdrReader(payload)
    stamp_ns, _ = reader.header()
    twist = _finite(reader.read(_TWIST, 8), "twist")
    return stamp_ns, twist[0], twist[5]


def encode_camera_info(stamp_ns: int, frame_id: str, camera: CameraModel) -> bytes:
    """Encode sensor_msgs/CameraInfo of a camera without distortion."""
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    writer = CdrWriter().header(stamp_ns, frame_id)
    writer.write(_HEIGHT_WIDTH, 4, camera.height_px, camera.width_px).string("plumb_bob")
    writer.write(U32, 4, 5).floats((0.0,) * 5, "d")  # d; then k, r and p
    writer.floats((fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), "d").floats(_IDENTITY_3, "d")
    writer.floats((fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0), "d")
    return writer.write(_ROI, 4, 0, 0, 0, 0, 0, 0, 0).bytes()


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """sensor_msgs/CameraInfo for the images as they are sent, with binning and roi applied.

    Attributes:
        camera: rectified camera: from the projection matrix P, or from K if P is zero.
        lens: distortion of the raw image; None if all coefficients are zero.
        cut: binning and roi as text; empty if full images are sent.
    """

    stamp_ns: int
    camera: CameraModel
    lens: Lens | None
    cut: str


def decode_camera_info(payload: bytes) -> CameraCalibration:
    """Decode a sensor_msgs/CameraInfo."""
    reader = CdrReader(payload)
    stamp_ns, _ = reader.header()
    height, width = reader.read(_HEIGHT_WIDTH, 4)
    model = reader.string()
    count, begin = reader.sequence(8)
    if count > _MAX_COEFFICIENTS:
        raise DecodeError(
            f"distortion of {count} coefficients, expected {_MAX_COEFFICIENTS} or less"
        )
    d = struct.unpack_from(f"<{count}d", payload, begin)
    k = reader.read(_K, 8)
    reader.skip(_K.size, 8)  # r: rotation of a stereo camera
    p = reader.read(_P, 8)
    step_x, step_y, x, y, roi_width, roi_height = _region_of_interest(reader, width, height)

    def pinhole(fx: float, fy: float, cx: float, cy: float) -> CameraModel:
        """Return the camera of the sent images, from intrinsics of the entire sensor."""
        try:
            return CameraModel(
                roi_width // step_x, roi_height // step_y,
                fx / step_x, fy / step_y, (cx - x) / step_x, (cy - y) / step_y,
            )  # fmt: skip
        except ValueError as error:
            raise DecodeError(str(error)) from None

    raw = k[0], k[4], k[2], k[5]  # fx, fy, cx, cy of the raw image
    camera = pinhole(*((p[0], p[5], p[2], p[6]) if p[0] != 0.0 else raw))
    has_distortion = any(_finite(d, "distortion"))
    lens = Lens(one_line(model, 40), d, pinhole(*raw)) if has_distortion else None
    is_full = (step_x, step_y, roi_width, roi_height) == (1, 1, width, height)
    cut = f"binning {step_x}x{step_y}, roi {roi_width}x{roi_height} at ({x}, {y})"
    return CameraCalibration(stamp_ns, camera, lens, "" if is_full else cut)


def _region_of_interest(
    reader: CdrReader, width: int, height: int
) -> tuple[int, int, int, int, int, int]:
    """Read the part of the sensor that images show: binning in x and y, x, y, width and height."""
    binning_x, binning_y, x, y, roi_height, roi_width, _ = reader.read(_ROI, 4)
    if roi_height == 0 or roi_width == 0:
        x, y, roi_height, roi_width = 0, 0, height, width
    if x + roi_width > width or y + roi_height > height:
        raise DecodeError(
            f"region of interest (roi) {roi_width}x{roi_height} at ({x}, {y}) px is outside the "
            f"image of {width}x{height}"
        )
    return max(binning_x, 1), max(binning_y, 1), x, y, roi_width, roi_height


def encode_occupancy_grid(stamp_ns: int, grid: Grid, frame_id: str = MAP_FRAME) -> bytes:
    """Encode nav_msgs/OccupancyGrid of an int8 grid."""
    h, w = grid.cells.shape
    writer = CdrWriter().header(stamp_ns, frame_id).stamp_ns(stamp_ns)
    writer.write(_GRID_INFO, 4, grid.resolution_m, w, h)
    writer.write(_POSE, 8, *grid.origin_xy_m, 0.0, 0.0, 0.0, 0.0, 1.0)
    writer.write(U32, 4, h * w)
    return writer.bytes(memoryview(np.ascontiguousarray(grid.cells, dtype=np.int8).reshape(-1)))


def decode_occupancy_grid(payload: bytes) -> tuple[int, Grid]:
    """Decode nav_msgs/OccupancyGrid as (stamp_ns, grid).

    The int8 cells are a read-only view of the payload. The resolution is the shortest decimal of
    its float32 (0.05, not 0.0500000007), so that cell positions do not drift.
    """
    reader = CdrReader(payload)
    stamp_ns, _ = reader.header()
    reader.skip(STAMP.size, 4)
    resolution, width, height = reader.read(_GRID_INFO, 4)
    T = read_pose(reader)
    count, begin = reader.sequence(1)
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise DecodeError(f"not a grid: resolution {resolution:g} m, must be above 0")
    if count != width * height:
        raise DecodeError(
            f"not a grid: {count} cells for {width}x{height}, expected {width * height}"
        )
    cells = np.ndarray((height, width), np.int8, payload, begin)
    origin_xy_m = float(T[0, 3]), float(T[1, 3])
    return stamp_ns, Grid(cells, origin_xy_m, float(str(np.float32(resolution))))
