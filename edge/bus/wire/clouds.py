"""Codecs of sensor_msgs/PointCloud2 and LaserScan, decoded into preallocated points."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from edge.bus.wire import kernels
from edge.bus.wire.cdr import U8, U32, CdrReader, CdrWriter, DecodeError
from edge.geometry import FARTHEST_M

_HEIGHT_WIDTH = struct.Struct("<II")
# Angles: first, last, increment; time increment, scan time; smallest and largest range.
_SCAN = struct.Struct("<7f")
_FLOAT32 = 7  # datatype of sensor_msgs/PointField
_MAX_FIELDS = 64  # of a point
_FARTHEST_M = 0.5 * FARTHEST_M  # the map rejects end points of beams beyond FARTHEST_M


def encode_point_cloud(stamp_ns: int, frame_id: str, points_m: np.ndarray) -> bytes:
    """Encode sensor_msgs/PointCloud2 of (n, 3) float32 points with fields x, y, z only."""
    return b"".join(cloud_parts(stamp_ns, frame_id, points_m))


def cloud_parts(
    stamp_ns: int, frame_id: str, points_m: np.ndarray
) -> tuple[bytes, memoryview, bytes]:
    """Return the parts of `encode_point_cloud`. The second is a view of the points if possible."""
    points = np.ascontiguousarray(points_m, dtype=np.float32)
    n = len(points)
    writer = CdrWriter().header(stamp_ns, frame_id).write(_HEIGHT_WIDTH, 4, 1, n).write(U32, 4, 3)
    for i, name in enumerate("xyz"):  # name, offset, datatype, count
        writer.string(name).write(U32, 4, 4 * i).write(U8, 1, _FLOAT32).write(U32, 4, 1)
    # is_bigendian, point_step, row_step, size of data
    writer.write(U8, 1, 0).write(U32, 4, 12).write(U32, 4, 12 * n).write(U32, 4, 12 * n)
    is_dense = U8.pack(bool(np.isfinite(points).all()))
    return writer.bytes(), memoryview(points.reshape(-1).view(np.uint8)), is_dense


def _limit_text(n: int) -> str:
    return f"at most {n} are allowed: raise source.max_cloud_points"


def _xyz_offsets(reader: CdrReader) -> tuple[int, int, int]:
    """Return the offsets of x, y and z in a point, from the message's list of fields."""
    (count,) = reader.read(U32, 4)
    if count > _MAX_FIELDS:
        raise DecodeError(f"cloud has {count} fields, at most {_MAX_FIELDS} are allowed")
    offsets = {}
    for _ in range(count):
        name = reader.string()
        (offset,) = reader.read(U32, 4)
        (datatype,) = reader.read(U8, 1)
        reader.read(U32, 4)  # count
        if datatype == _FLOAT32:
            offsets[name] = offset
    if not offsets.keys() >= {"x", "y", "z"}:
        raise DecodeError("cloud lacks one of the fields x, y, z, of type float32")
    return offsets["x"], offsets["y"], offsets["z"]


def decode_point_cloud_into(payload: bytes, out_m: np.ndarray, keep_invalid: bool = False) -> int:
    """Write the points of a sensor_msgs/PointCloud2 into `out_m`, (cap, 3) float32.

    The message may have any layout of fields with float32 x, y, z.

    Args:
        payload: the message.
        out_m: the points in metres, in the message's frame.
        keep_invalid: also write points with NaN or inf.

    Returns:
        The number of points written.

    Raises:
        DecodeError: the message is malformed, or has more points than `cap`.
    """
    reader = CdrReader(payload)
    reader.header()
    height, width = reader.read(_HEIGHT_WIDTH, 4)
    offsets = _xyz_offsets(reader)
    (big_endian,) = reader.read(U8, 1)
    point_step, row_step = reader.read(_HEIGHT_WIDTH, 4)
    size, begin = reader.sequence(1)
    n = height * width
    if n == 0:
        return 0
    if n > len(out_m):
        raise DecodeError(f"cloud of {n} points, {_limit_text(len(out_m))}")
    # Drivers of organized clouds set row_step to 0, to all of the data or to a number of points.
    if height == 1 or size == n * point_step:
        row_step = width * point_step
    if max(offsets) + 4 > point_step or row_step < width * point_step or height * row_step > size:
        raise DecodeError(
            f"cloud {width}x{height}: point_step {point_step} and row_step {row_step} do not fit "
            f"{size} bytes of data: row_step must be width * point_step or more"
        )
    if keep_invalid:
        code, strides = ">f4" if big_endian else "<f4", (row_step, point_step)
        for axis, offset in enumerate(offsets):
            # A view of one coordinate of all points.
            column = np.ndarray((height, width), code, payload, begin + offset, strides)
            out_m[:n, axis] = column.reshape(-1)
        return n
    return kernels.cloud_points(
        np.frombuffer(payload, np.uint8), begin, height, width, row_step, point_step, offsets,
        bool(big_endian), out_m.view(np.uint32),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """sensor_msgs/LaserScan; beam i points at angle_min + i * angle_increment, left positive.

    Values of `ranges_m` (REP 117):

    - from range_min to below range_max: a hit.
    - range_max and more, or +inf: no obstacle within range_max.
    - less than range_min, -inf or NaN: no measurement.

    Attributes:
        angle_min_rad: angle of beam 0.
        range_min_m: see above.
        range_max_m: see above.
        ranges_m: (n,) float32, a read-only view of the payload.
    """

    stamp_ns: int
    frame_id: str
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: np.ndarray


def encode_laser_scan(
    stamp_ns: int,
    frame_id: str,
    angle_min_rad: float,
    angle_increment_rad: float,
    range_max_m: float,
    ranges_m: np.ndarray,
) -> bytes:
    """Encode sensor_msgs/LaserScan of (n,) ranges; `range_max_m` or more means no return."""
    ranges = np.ascontiguousarray(ranges_m, dtype=np.float32)
    last = angle_min_rad + max(len(ranges) - 1, 0) * angle_increment_rad
    writer = CdrWriter().header(stamp_ns, frame_id)
    writer.write(_SCAN, 4, angle_min_rad, last, angle_increment_rad, 0.0, 0.0, 0.0, range_max_m)
    writer.write(U32, 4, len(ranges))
    no_intensities = U32.pack(0)
    return b"".join((writer.bytes(memoryview(ranges.view(np.uint8))), no_intensities))


def decode_laser_scan(payload: bytes) -> LaserScan:
    """Decode a sensor_msgs/LaserScan without its intensities."""
    reader = CdrReader(payload)
    stamp_ns, frame_id = reader.header()
    first, last, increment, _, _, range_min, range_max = reader.read(_SCAN, 4)
    count, begin = reader.sequence(4)
    reader.sequence(4)
    if not np.isfinite((first, last, increment, range_min)).all() or np.isnan(range_max):
        raise DecodeError("scan: its angles or range limits are NaN or inf")
    ranges = np.ndarray((count,), "<f4", payload, begin)
    return LaserScan(stamp_ns, frame_id, first, increment, range_min, range_max, ranges)


def decode_scan_points_into(payload: bytes, out_m: np.ndarray, free: bool = False) -> int:
    """Write the hits of a sensor_msgs/LaserScan into `out_m` (cap, 3) float32, in the scan's frame.

    Args:
        payload: the message.
        out_m: the points in metres.
        free: also write beams without a hit, as (x, y, inf): see `kernels.scan_points`.

    Returns:
        The number of rows written.

    Raises:
        DecodeError: the message is malformed, or has more beams than `cap`.
    """
    scan = decode_laser_scan(payload)
    if len(scan.ranges_m) > len(out_m):
        raise DecodeError(f"scan of {len(scan.ranges_m)} beams, {_limit_text(len(out_m))}")
    return kernels.scan_points(
        scan.ranges_m,
        scan.angle_min_rad,
        scan.angle_increment_rad,
        scan.range_min_m,
        scan.range_max_m,
        min(scan.range_max_m, _FARTHEST_M) if free else 0.0,
        out_m,
    )
