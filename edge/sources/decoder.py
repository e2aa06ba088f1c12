"""Decoder of CDR payloads into typed messages for a synchronizer."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, compressed, messages
from edge.config import SourceConfig
from edge.sources.messages import (
    CameraInfo,
    CameraInfo2,
    Cloud,
    DepthImage,
    DepthImage2,
    Image,
    Image2,
    LaserScanFrame,
    Odometry,
    SensorFrame,
    WrongSizeError,
)
from edge.sources.synchronizer import TimeSynchronizer
from edge.sources.tf import RobotFrames

_WAIT_SHARE = 0.8  # part of a frame's waiting time in which its pose may wait for transforms
_INFO_BODY = 12  # of camera info: offset behind CDR header and stamp; the rest hardly ever changes


def _check_height(
    header: messages.ImageHeader | compressed.CompressedHeader, out: np.ndarray
) -> int:
    """Return the height; 0 for an empty image. Raise WrongSizeError unless it fits `out`."""
    if header.height * header.width == 0:
        return 0
    if (header.height, header.width) != out.shape[:2]:
        height, width = out.shape[:2]
        says = f"camera info says {width}x{height}"
        raise WrongSizeError(f"image is {header.width}x{header.height}, {says}")
    return header.height


def _image_into(settings: SourceConfig, payload: bytes, out: np.ndarray) -> int:
    header = messages.decode_image_header(payload)
    if (height := _check_height(header, out)) > 0:
        messages.decode_image_into(payload, header, out, settings.depth_unit_m)
    return height


def _compressed_into(settings: SourceConfig, payload: bytes, out: np.ndarray) -> int:
    header = compressed.decode_compressed_header(payload)
    if (height := _check_height(header, out)) > 0:
        compressed.decode_compressed_into(payload, header, out, settings.depth_unit_m)
    return height


KINDS: dict[Topic, type[SensorFrame]] = {
    topics.CLOUD: Cloud,
    topics.SCAN: LaserScanFrame,
    topics.DEPTH: DepthImage,
    topics.RGB: Image,
    topics.DEPTH2: DepthImage2,
    topics.RGB2: Image2,
}
"""Message class of each topic."""

INFOS: dict[Topic, type[CameraInfo]] = {
    topics.CAMERA_INFO: CameraInfo,
    topics.CAMERA_INFO2: CameraInfo2,
}
"""Message class of each topic of intrinsics."""

_DECODERS: dict[str, Callable[[SourceConfig, bytes, np.ndarray], int]] = {
    "sensor_msgs/PointCloud2": lambda _, payload, out: messages.decode_point_cloud_into(
        payload, out
    ),
    "sensor_msgs/LaserScan": lambda settings, payload, out: messages.decode_scan_points_into(
        payload, out, settings.scan_inf == "free"
    ),
    "sensor_msgs/Image": _image_into,
    "sensor_msgs/CompressedImage": _compressed_into,
}
"""ROS 2 type → function (settings, payload, out) that decodes into `out`, and returns the rows."""


class CdrDecoder:
    """Passes payloads to a synchronizer as typed messages or as counted drops; for one thread.

    Args:
        clock: time of arrivals, in ns.
        frames: the robot's tf frames, to convert poses into `map`. If None, odometry is in `map`
            already.
    """

    def __init__(
        self,
        synchronizer: TimeSynchronizer,
        clock: Callable[[], int] = time.monotonic_ns,
        frames: RobotFrames | None = None,
    ) -> None:
        self._synchronizer = synchronizer
        self._settings = synchronizer.config.source
        self._clock = clock
        self._frames = frames
        self._last_info: dict[Topic, bytes] = {}
        config = synchronizer.config
        wait_ns = _WAIT_SHARE * 1e9 * config.source.wait_s
        self._wait_ns = math.inf if config.loop.lockstep else wait_ns
        self._max_waiting = config.source.odometry_ring
        # (arrival in ns, pose) of the poses that wait for transforms.
        self._waiting: deque[tuple[int, messages.OdometryMessage]] = deque()

    def offer(self, topic: Topic, payload: bytes, type_name: str = "") -> None:
        """Decode one message of a sensor topic in `edge.bus.topics`.

        Args:
            topic: the topic.
            payload: CDR.
            type_name: ROS 2 type of the payload, if it is not the topic's own type.
        """
        self._synchronizer.received(topic.key)
        if not payload:
            self._synchronizer.count(topic.key, "empty")
            return
        try:
            if topic is topics.ODOMETRY:
                self.offer_pose(messages.decode_odometry(payload))
            elif topic in INFOS:
                self._offer_camera_info(topic, payload)
            else:
                self._offer_frame(topic, payload, type_name or topic.type)
        except DecodeError as error:
            self._synchronizer.count(topic.key, "malformed", str(error))

    def offer_pose(self, sample: messages.OdometryMessage) -> None:
        """Process a pose from an odometry message or from tf."""
        if self._frames is None:
            self._synchronizer.offer(Odometry(sample.stamp_ns, sample.T_map_base))
            return
        self._waiting.append((self._clock(), sample))
        self.convert_waiting_poses()

    def convert_waiting_poses(self) -> None:
        """Convert waiting poses into `map` if their transforms have come or waiting is over."""
        while self._waiting:
            came_ns, sample = self._waiting[0]
            placed = self._frames.base_in_map(sample)
            waited = self._clock() - came_ns > self._wait_ns
            # An age above 0: newer transforms may still come.
            if placed.age_ns and not waited and len(self._waiting) < self._max_waiting:
                return
            self._waiting.popleft()
            if placed.T is None:
                self._synchronizer.count(topics.ODOMETRY.key, "no_transform", placed.why)
            else:
                self._synchronizer.offer(Odometry(sample.stamp_ns, placed.T, placed.age_ns))

    def _offer_frame(self, topic: Topic, payload: bytes, type_name: str) -> None:
        """Pass a frame to the synchronizer, which decodes it only if it is used."""
        kind, into = KINDS[topic], _DECODERS[type_name]
        stamp_ns, frame_id = messages.peek_header(payload)
        # Depth is registered to the colour image: it uses that mount, whatever its frame_id is.
        by_tf = self._frames is not None and self._frames.by_tf and not issubclass(kind, DepthImage)
        if by_tf and (why := self._frames.why_unplaced(frame_id)):
            self._synchronizer.count(topic.key, "no_transform", why)
            return
        decode = partial(into, self._settings, payload)
        self._synchronizer.offer(kind(stamp_ns, self._clock(), decode, frame_id, len(payload)))

    def _offer_camera_info(self, topic: Topic, payload: bytes) -> None:
        """Process camera info; drivers repeat it with every frame, but it hardly ever changes."""
        if payload[_INFO_BODY:] != self._last_info.get(topic):
            info = messages.decode_camera_info(payload)
            self._synchronizer.offer(INFOS[topic](info.camera, info.lens, info.cut))
            self._last_info[topic] = payload[_INFO_BODY:]
