"""What sensors say, typed: how a source hands it to the time synchronizer, on whatever it came.

The pixels and points of a frame stay as they came until the frame is used: only then does its
`into` write them to their place in a slot of the pool. Most frames never are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Union

import numpy as np

from edge.geometry import CameraModel, Lens


class WrongSizeError(ValueError):
    """An image that is not as large as the camera says."""


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Where the base is in `map`: (4, 4) float64.

    Attributes:
        age_ns: how much older than the stamp the transforms are that took it into `map`.
    """

    stamp_ns: int
    T_map_base: np.ndarray
    age_ns: int = 0
    topic: ClassVar[str] = "odom"


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Intrinsics of the images that follow.

    Attributes:
        camera: of the images once they are rectified.
        lens: how they are distorted before that; None: not at all.
        cut: see `edge.bus.wire.messages.Calibration`.
    """

    camera: CameraModel
    lens: Lens | None = None
    cut: str = ""
    topic: ClassVar[str] = "camera/info"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture or sweep, not yet decoded.

    Attributes:
        stamp_ns: when it was taken.
        arrived_ns: when it came, on the synchronizer's clock.
        into: writes it into an array of its field and returns how many rows or points that were;
            raises ValueError, in one line, for what is malformed, `WrongSizeError` among them.
        frame_id: the frame that it is in, for a robot whose mounts move.
        size: bytes that it takes until it is used.
        topic: what drops are told and counted under.
        field: the attribute of `Observation`, and of a pool's slot, that it becomes.
    """

    stamp_ns: int
    arrived_ns: int
    into: Callable[[np.ndarray], int]
    frame_id: str = ""
    size: int = 0
    topic: ClassVar[str]
    field: ClassVar[str]


class Image(Frame):
    """Into (h, w, 3) uint8 RGB."""

    topic, field = "camera/rgb", "rgb"


class DepthImage(Frame):
    """Into (h, w) float32 metres, registered to the colour image; NaN or 0 = no return. The
    synchronizer drops returns beyond the camera's range."""

    topic, field = "camera/depth", "depth_m"


class Cloud(Frame):
    """Into (cap, 3) float32 metres in the LiDAR's frame."""

    topic, field = "lidar/points", "cloud_m"


class Scan(Cloud):
    """The hits of a 2D LiDAR in its own plane, as a cloud; a row (x, y, inf) is a beam that met
    nothing up to (x, y, 0)."""

    topic = "lidar/scan"


class Placed(NamedTuple):
    """One frame in another at an instant.

    Attributes:
        T: (4, 4); None: not known.
        age_ns: how much older than the instant the transforms are; 0: they are of the instant.
        why: why it is not known, in one line.
    """

    T: np.ndarray | None
    age_ns: int = 0
    why: str = ""


MountAt = Callable[[str, int], Placed]
"""Returns `T_base_sensor` of the sensor whose messages name a frame, at a stamp in ns: a camera's
from its optical frame."""

Message = Union[Odometry, CameraInfo, Frame]
