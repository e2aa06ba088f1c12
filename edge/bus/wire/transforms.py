"""Codecs of tf2_msgs/TFMessage and nav_msgs/Path."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.bus.wire.cdr import HEADER, U32, CdrReader, CdrWriter, DecodeError
from edge.geometry import quaternion_of, se3_from_quaternion

_TRANSFORM = struct.Struct("<7d")  # x, y, z; quaternion x, y, z, w
_MIN_TRANSFORM_BYTES = 12 + 1 + _TRANSFORM.size  # least bytes of one transform
MOST_TRANSFORMS = 4096
"""Largest number of transforms in a message."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """geometry_msgs/TransformStamped.

    Attributes:
        parent: name of the parent frame.
        child: name of the child frame.
        T: (4, 4) float64, takes points of `child` to `parent`.
    """

    stamp_ns: int
    parent: str
    child: str
    T: np.ndarray


def decode_transforms(payload: bytes) -> tuple[list[Transform], list[str]]:
    """Decode tf2_msgs/TFMessage; the leading slash of a frame (ROS 1) is removed.

    Returns:
        The valid transforms, and a description of each other one, as tf2 skips only those.
    """
    reader = CdrReader(payload)
    (count,) = reader.read(U32, 4)
    if count > min(MOST_TRANSFORMS, len(payload) // _MIN_TRANSFORM_BYTES):
        raise DecodeError(
            f"message of {count} transforms: at most {MOST_TRANSFORMS} are allowed, and its "
            f"{len(payload)} bytes have room for {len(payload) // _MIN_TRANSFORM_BYTES}"
        )
    valid, faults = [], []
    for _ in range(count):
        transform = _read_transform(reader)
        if isinstance(transform, str):
            faults.append(transform)
        else:
            valid.append(transform)
    return valid, faults


def encode_transforms(transforms: Sequence[Transform]) -> bytes:
    """Encode tf2_msgs/TFMessage."""
    writer = CdrWriter().write(U32, 4, len(transforms))
    for t in transforms:
        writer.header(t.stamp_ns, t.parent).string(t.child)
        writer.write(_TRANSFORM, 8, *t.T[:3, 3], *quaternion_of(t.T))
    return writer.bytes()


def _read_transform(reader: CdrReader) -> Transform | str:
    """Read one geometry_msgs/TransformStamped; return a description of an invalid one."""
    stamp_ns, parent = reader.header()
    parent, child = parent.lstrip("/"), reader.string().lstrip("/")
    values = reader.read(_TRANSFORM, 8)
    if not all(map(math.isfinite, values)):
        return f"from '{child}' to '{parent}' (NaN or inf)"
    try:
        T = se3_from_quaternion(values[:3], values[3:])
    except ValueError as error:
        return f"from '{child}' to '{parent}' ({error})"
    return Transform(stamp_ns, parent, child, T)


def encode_path(
    stamp_ns: int, frame_id: str, poses: np.ndarray, z_m: np.ndarray | float = 0.0
) -> bytes:
    """Encode nav_msgs/Path of (n, 3) poses (x and y in metres, yaw in radians) with one stamp.

    Args:
        stamp_ns: stamp of the path and of all poses.
        frame_id: frame of the poses.
        poses: (n, 3).
        z_m: height of all poses, or (n,) heights.
    """
    n = len(poses)
    writer = CdrWriter().header(stamp_ns, frame_id).write(U32, 4, n)
    if n == 0:
        return writer.bytes()
    values = np.zeros((n, 7))  # by pose, as in `_TRANSFORM`; a turn by yaw has only z and w
    values[:, :2], values[:, 2] = poses[:, :2], z_m
    values[:, 5], values[:, 6] = np.sin(0.5 * poses[:, 2]), np.cos(0.5 * poses[:, 2])
    first = writer.header(stamp_ns, frame_id).write(_TRANSFORM, 8, *values[0]).bytes()
    # A pose ends at a multiple of eight bytes, so all later poses have the same layout: copy the
    # bytes of one n - 1 times, and overwrite the numbers at the end of each.
    unpadded = CdrWriter().header(stamp_ns, frame_id).write(_TRANSFORM, 8, *values[0]).bytes()
    rest = np.tile(np.frombuffer(unpadded[len(HEADER) :], np.uint8), (n - 1, 1))
    rest[:, -_TRANSFORM.size :] = values[1:].astype("<f8", copy=False).view(np.uint8)
    return first + rest.tobytes()
