"""Typed sensor messages, as sources pass them to the time synchronizer; independent of transport.

The payload of a frame is decoded only when the frame is used: `into` then writes it into a slot of
the pool. Most frames are never used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Union

import numpy as np

from edge.geometry import CameraModel, Lens


class WrongSizeError(ValueError):
    """An image has another size than the camera info."""


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Pose of the base in `map`.

    Attributes:
        stamp_ns: time of measurement.
        T_map_base: (4, 4) float64.
        age_ns: age, at the stamp, of the transforms that converted the pose into `map`.
    """

    stamp_ns: int
    T_map_base: np.ndarray
    age_ns: int = 0
    topic: ClassVar[str] = "odom"
    camera_index: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Intrinsics of the images that follow.

    Attributes:
        lens: distortion of the raw images; None: no distortion.
        cut: see `edge.bus.wire.messages.CameraCalibration`.
    """

    camera: CameraModel
    lens: Lens | None = None
    cut: str = ""
    topic: ClassVar[str] = "camera/info"
    camera_index: ClassVar[int] = 0


class CameraInfo2(CameraInfo):
    """Intrinsics of the second camera."""

    topic, camera_index = "camera2/info", 1


@dataclass(frozen=True, slots=True, eq=False)
class SensorFrame:
    """One image or sweep, not yet decoded.

    Attributes:
        stamp_ns: time of measurement.
        arrived_ns: time of arrival, on the synchronizer's clock.
        into: decodes the frame into an array of `field`, and returns the number of rows or points;
            raises ValueError (or `WrongSizeError`) with one line if the frame is malformed.
        frame_id: the sensor's tf frame, for robots whose mounts move.
        size: bytes in memory until the frame is used.
        topic: name under which drops are logged and counted.
        camera_index: see `Observation`; 0 for frames of no camera.
        field: the attribute of `Observation`, and of a pool's slot, for the decoded frame.
    """

    stamp_ns: int
    arrived_ns: int
    into: Callable[[np.ndarray], int]
    frame_id: str = ""
    size: int = 0
    topic: ClassVar[str]
    field: ClassVar[str]
    camera_index: ClassVar[int] = 0


class Image(SensorFrame):
    """A colour image; decodes into (h, w, 3) uint8 RGB."""

    topic, field = "camera/rgb", "rgb"


class DepthImage(SensorFrame):
    """A depth image registered to the colour image; decodes into (h, w) float32 metres.

    NaN or 0 = no return. The synchronizer drops returns beyond the camera's range.
    """

    topic, field = "camera/depth", "depth_m"


class Image2(Image):
    """A colour image of the second camera."""

    topic, camera_index = "camera2/rgb", 1


class DepthImage2(DepthImage):
    """A depth image of the second camera."""

    topic, camera_index = "camera2/depth", 1


class Cloud(SensorFrame):
    """A point cloud; decodes into (cap, 3) float32 metres in the LiDAR's frame."""

    topic, field = "lidar/points", "cloud_m"


class LaserScanFrame(Cloud):
    """A 2D LiDAR scan; decodes its hits as a cloud in the scan plane.

    A row (x, y, inf) is a beam that hit nothing up to (x, y, 0).
    """

    topic = "lidar/scan"


class TransformLookup(NamedTuple):
    """The result of a tf lookup at an instant.

    Attributes:
        T: (4, 4); None: not known.
        age_ns: age of the transforms at the instant; 0: they are exact.
        why: why `T` is not known, in one line.
    """

    T: np.ndarray | None
    age_ns: int = 0
    why: str = ""


MountAt = Callable[[str, int], TransformLookup]
"""Returns `T_base_sensor` for a frame id and a stamp in ns. A camera's frame is its optical frame.
"""

Message = Union[Odometry, CameraInfo, SensorFrame]
