"""Codec of vision_msgs/Detection2DArray and Detection3DArray, as since ROS 2 Humble."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge.bus.wire.cdr import U32, CdrWriter

Triple = tuple[float, float, float]
_BOX_2D = struct.Struct("<5d")  # x, y and angle of the centre; width and height
_SIZE = struct.Struct("<3d")
_SCORE = struct.Struct("<d")
_POSE = struct.Struct("<7d")  # position and quaternion
_COVARIANCE = (0.0,) * 36  # unknown
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Box3D(NamedTuple):
    """An object with its box, whose axes are those of the frame.

    Attributes:
        score: confidence in [0, 1].
        size_m: sides of the box; 0 if they are not known.
    """

    id: int
    name: str
    score: float
    center_m: Triple
    size_m: Triple


def encode_detections(
    stamp_ns: int, frame_id: str, names: Sequence[str], score: np.ndarray, xyxy_px: np.ndarray
) -> bytes:
    """Encode a vision_msgs/Detection2DArray.

    Args:
        stamp_ns: time of the image.
        frame_id: frame of the camera.
        names: n classes.
        score: (n,) scores.
        xyxy_px: (n, 4) boxes.
    """
    writer = CdrWriter().header(stamp_ns, frame_id).write(U32, 4, len(names))
    boxes = np.asarray(xyxy_px, np.float64).reshape(-1, 4)
    for name, p, (x0, y0, x1, y1) in zip(names, score, boxes, strict=True):
        writer.header(stamp_ns, frame_id)
        _write_hypothesis(writer, name, float(p), (0.0, 0.0, 0.0))
        writer.write(_BOX_2D, 8, 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0, x1 - x0, y1 - y0)
        writer.string("")  # id: boxes are not tracked from image to image
    return writer.bytes()


def encode_boxes(stamp_ns: int, frame_id: str, boxes: Sequence[Box3D]) -> bytes:
    """Encode a vision_msgs/Detection3DArray of all objects."""
    writer = CdrWriter().header(stamp_ns, frame_id).write(U32, 4, len(boxes))
    for box in boxes:
        writer.header(stamp_ns, frame_id)
        _write_hypothesis(writer, box.name, box.score, box.center_m)
        writer.write(_POSE, 8, *box.center_m, *_UPRIGHT).write(_SIZE, 8, *box.size_m)
        writer.string(str(box.id))
    return writer.bytes()


def _write_hypothesis(writer: CdrWriter, name: str, score: float, center_m: Triple) -> None:
    """Append the list of hypotheses, which has one."""
    writer.write(U32, 4, 1).string(name).write(_SCORE, 8, score)
    writer.write(_POSE, 8, *center_m, *_UPRIGHT).floats(_COVARIANCE, "d")
