"""CDR payloads, opened and handed to a synchronizer as what they say."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, compressed, messages
from edge.sources.messages import (
    CameraInfo,
    Cloud,
    DepthImage,
    Frame,
    Image,
    Mount,
    Odometry,
    Scan,
    WrongSizeError,
)
from edge.sources.synchronizer import TimeSynchronizer
from edge.sources.tf import Frames

_INFO_BODY = 12  # behind CDR header and stamp: a camera says the same again and again


def _check_size(header: messages.ImageHeader | compressed.CompressedHeader, out: np.ndarray) -> int:
    """The height, 0 for an empty picture; raises WrongSizeError."""
    if header.height * header.width == 0:
        return 0
    if (header.height, header.width) != out.shape[:2]:
        height, width = out.shape[:2]
        says = f"camera info says {width}x{height}"
        raise WrongSizeError(f"{header.width}x{header.height}, {says}")
    return header.height


def _image_into(payload: bytes, out: np.ndarray) -> int:
    header = messages.decode_image_header(payload)
    if (height := _check_size(header, out)) > 0:
        messages.decode_image_into(payload, header, out)
    return height


def _compressed_into(payload: bytes, out: np.ndarray) -> int:
    header = compressed.decode_compressed_header(payload)
    if (height := _check_size(header, out)) > 0:
        compressed.decode_compressed_into(payload, header, out)
    return height


KINDS: dict[Topic, type[Frame]] = {
    topics.CLOUD: Cloud,
    topics.SCAN: Scan,
    topics.DEPTH: DepthImage,
    topics.RGB: Image,
}
"""What the messages of each topic are."""

_INTO: dict[str, Callable[[bytes, np.ndarray], int]] = {
    "sensor_msgs/PointCloud2": messages.decode_point_cloud_into,
    "sensor_msgs/LaserScan": messages.decode_scan_points_into,
    "sensor_msgs/Image": _image_into,
    "sensor_msgs/CompressedImage": _compressed_into,
}
"""How each type is opened."""


class CdrDecoder:
    """Hands payloads to a synchronizer as what they say, or as counted drops; for one thread.

    Args:
        frames: takes poses into `map` and knows where the sensors sit. Without it odometry is in
            `map` already, and the sensors sit where the configuration says.
    """

    def __init__(
        self,
        synchronizer: TimeSynchronizer,
        clock: Callable[[], int] = time.monotonic_ns,
        frames: Frames | None = None,
    ) -> None:
        self._synchronizer = synchronizer
        self._clock = clock
        self._frames = frames
        self._info = b""

    def offer(self, topic: Topic, payload: bytes, type_name: str = "") -> None:
        """Take one message of any topic in `edge.bus.topics` that sensors write.

        Args:
            type_name: what it is, where that is not the topic's own type.
        """
        self._synchronizer.received(topic.key)
        if not payload:
            self._synchronizer.count(topic.key, "empty")
            return
        try:
            if topic is topics.ODOMETRY:
                self.move(messages.decode_odometry(payload))
            elif topic is topics.CAMERA_INFO:
                self._describe(payload)
            else:
                self._show(topic, payload, type_name or topic.type)
        except DecodeError as error:
            self._synchronizer.count(topic.key, "malformed", str(error))

    def move(self, sample: messages.Odometry) -> None:
        """Take a pose, from an odometry message or from tf."""
        T_map_base: np.ndarray | None = sample.T_map_base
        if self._frames is not None:
            T_map_base = self._frames.base_in_map(sample)
        if T_map_base is None:
            detail = f"from {sample.frame_id} and {sample.child_frame_id}"
            self._synchronizer.count(Odometry.topic, "no_transform", detail)
            return
        self._synchronizer.offer(Odometry(sample.stamp_ns, T_map_base))

    def _show(self, topic: Topic, payload: bytes, type_name: str) -> None:
        kind, into = KINDS[topic], _INTO[type_name]
        stamp_ns, frame_id = messages.peek_header(payload)
        # Depth is registered to the colours: it sits where these do, whatever it says.
        if self._frames is not None and self._frames.by_tf and kind is not DepthImage:
            T_base_sensor = self._frames.mount_of(frame_id)
            if T_base_sensor is None:
                self._synchronizer.count(topic.key, "no_transform", f"from {frame_id}")
                return
            self._synchronizer.offer(Mount(kind.field, T_base_sensor))
        self._synchronizer.offer(kind(stamp_ns, self._clock(), partial(into, payload)))

    def _describe(self, payload: bytes) -> None:
        """Cameras describe themselves with every frame, and hardly ever anew."""
        if payload[_INFO_BODY:] != self._info:
            self._synchronizer.offer(CameraInfo(messages.decode_camera_info(payload)[1]))
            self._info = payload[_INFO_BODY:]
