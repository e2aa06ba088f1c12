"""Sensor messages from CDR to typed ones; frames are opened only when they are used."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, messages
from edge.sources.messages import (
    CameraInfo,
    Cloud,
    DepthImage,
    Frame,
    Image,
    Odometry,
    Scan,
    WrongSizeError,
)
from edge.sources.synchronizer import TimeSynchronizer

_INFO_BODY = 12  # behind CDR header and stamp: a camera says the same again and again


class CdrDecoder:
    """Hands payloads to a synchronizer as what they say, or as counted drops; for one thread."""

    def __init__(
        self, synchronizer: TimeSynchronizer, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._synchronizer = synchronizer
        self._clock = clock
        self._info = b""

    def offer(self, topic: Topic, payload: bytes) -> None:
        """Take one message of any topic in `edge.bus.topics` that sensors write."""
        self._synchronizer.counters["received"] += 1
        if not payload:
            self._synchronizer.count(topic.key, "empty")
            return
        try:
            if topic is topics.ODOMETRY:
                sample = messages.decode_odometry(payload)
                self._synchronizer.offer(Odometry(sample.stamp_ns, sample.T_map_base))
            elif topic is topics.CAMERA_INFO:
                self._describe(payload)
            else:
                kind, into = FRAMES[topic]
                stamp_ns = messages.peek_stamp_ns(payload)
                self._synchronizer.offer(kind(stamp_ns, self._clock(), partial(into, payload)))
        except DecodeError as error:
            self._synchronizer.count(topic.key, "malformed", str(error))

    def _describe(self, payload: bytes) -> None:
        """Cameras describe themselves with every frame, and hardly ever anew."""
        if payload[_INFO_BODY:] != self._info:
            self._synchronizer.offer(CameraInfo(messages.decode_camera_info(payload)[1]))
            self._info = payload[_INFO_BODY:]


def _image_into(payload: bytes, out: np.ndarray) -> int:
    header = messages.decode_image_header(payload)
    if header.height * header.width == 0:
        return 0
    if (header.height, header.width) != out.shape[:2]:
        height, width = out.shape[:2]
        says = f"camera info says {width}x{height}"
        raise WrongSizeError(f"{header.width}x{header.height}, {says}")
    messages.decode_image_into(payload, header, out)
    return header.height


FRAMES: dict[Topic, tuple[type[Frame], Callable[[bytes, np.ndarray], int]]] = {
    topics.CLOUD: (Cloud, messages.decode_point_cloud_into),
    topics.SCAN: (Scan, messages.decode_scan_points_into),
    topics.DEPTH: (DepthImage, _image_into),
    topics.RGB: (Image, _image_into),
}
"""What each topic's messages are, and how they are opened."""
