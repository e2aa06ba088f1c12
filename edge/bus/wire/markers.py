"""Codec of visualization_msgs/MarkerArray, which RViz and Foxglove draw."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from edge.bus.wire.cdr import STAMP, U8, U32, CdrWriter
from edge.geometry import SE2, quaternion_of

_IDS = struct.Struct("<iii")
_POSE = struct.Struct("<7d")
_SCALE = struct.Struct("<3d")
_COLOUR = struct.Struct("<4f")

# Values of visualization_msgs/Marker: kinds and actions.
ARROW, CUBE, LINE_STRIP, SPHERE_LIST, TEXT = 0, 1, 4, 7, 9
_ADD, _DELETE_ALL = 0, 3

ORIGIN = SE2(0.0, 0.0, 0.0)

RGBA = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One visualization_msgs/Marker.

    Attributes:
        id: number of the marker; unique in its group.
        kind: `ARROW`, `CUBE`, `LINE_STRIP`, `SPHERE_LIST` or `TEXT`.
        scale_m: size along x, y, z. For a text, z is the height. For a list of spheres, all are the
            diameter. For a line, x is the width.
        colour: red, green, blue, alpha, 0 to 1.
        z_m: height of the pose.
        text: text of a `TEXT`.
        points_m: (n, 3) centres of the spheres of a list, or corners of a line.
    """

    group: str
    id: int
    kind: int
    scale_m: tuple[float, float, float]
    colour: RGBA
    pose: SE2 = ORIGIN
    z_m: float = 0.0
    text: str = ""
    points_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))


def encode_markers(stamp_ns: int, frame_id: str, markers: Sequence[Marker]) -> bytes:
    """Encode a visualization_msgs/MarkerArray that replaces all markers sent before."""
    writer = CdrWriter().write(U32, 4, 1 + len(markers))
    clear = Marker("", 0, ARROW, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    _write(writer, stamp_ns, frame_id, clear, _DELETE_ALL)
    for marker in markers:
        _write(writer, stamp_ns, frame_id, marker, _ADD)
    return writer.bytes()


def _write(writer: CdrWriter, stamp_ns: int, frame_id: str, marker: Marker, action: int) -> None:
    """Append one visualization_msgs/Marker."""
    T = marker.pose.matrix(marker.z_m)
    writer.header(stamp_ns, frame_id).string(marker.group)
    writer.write(_IDS, 4, marker.id, marker.kind, action)
    writer.write(_POSE, 8, *T[:3, 3], *quaternion_of(T)).write(_SCALE, 8, *marker.scale_m)
    writer.write(_COLOUR, 4, *marker.colour)
    writer.write(STAMP, 4, 0, 0).write(U8, 1, 0)  # unlimited lifetime; not frame-locked
    points = np.ascontiguousarray(marker.points_m, "<f8").reshape(-1)
    writer.write(U32, 4, len(points) // 3)
    if len(points):
        writer.block(8, memoryview(points.view(np.uint8)))
    writer.write(U32, 4, 0).string("")  # colors; texture_resource
    writer.header(0, "").string("").write(U32, 4, 0)  # texture
    writer.write(U32, 4, 0).string(marker.text)  # uv_coordinates; text
    writer.string("").string("").write(U32, 4, 0).write(U8, 1, 0)  # no mesh
