"""Observations from Zenoh: CDR on ring channels that the loop polls, never callbacks.

A ring keeps the newest messages and lets the rest go, so a loop that lags never lags more. A look
takes a ring's worth of each at most, so that no flood keeps the loop from its next tick.
Frames are decoded only when they are used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.session import Ring
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, messages
from edge.config import Config
from edge.geometry import SE2
from edge.sources.goal_status import GoalStatusInbox
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
from edge.sources.streams import KEPT
from edge.sources.synchronizer import TimeSynchronizer
from edge.types import Observation

_PAUSE_S = 0.0003
_INFO_BODY = 12  # behind CDR header and stamp: a camera says the same again and again


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


class ZenohSource:
    """The sensors under `zenoh.prefix` as Observations (an `edge.loop.source.Source`).

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._synchronizer = TimeSynchronizer(config)
        self._decoder = CdrDecoder(self._synchronizer)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        # How many messages of each topic to keep between polls; odometry is drained first.
        kept = {topics.ODOMETRY: config.source.odometry_ring, topics.CAMERA_INFO: 1}
        heard = self._synchronizer.streams
        kept |= {topic: KEPT for topic, (kind, _) in FRAMES.items() if kind.field in heard}
        self._rings = {
            topic: Ring(session, config.zenoh.key(topic.key), n) for topic, n in kept.items()
        }
        self.inbox = GoalStatusInbox(session, config.zenoh)

    @property
    def counters(self) -> dict[str, int]:
        return self._synchronizer.counters

    @property
    def epoch(self) -> int:
        return self._synchronizer.odometry.epoch

    @property
    def pose(self) -> SE2 | None:
        return self._synchronizer.odometry.newest_pose

    def poll(self) -> Observation | None:
        """See `edge.loop.source.Source`."""
        self._drain()
        return self._synchronizer.poll()

    def wait(self, timeout_s: float) -> bool:
        """See `edge.loop.source.Source`; looks every 0.3 ms, since rings cannot be waited on."""
        deadline_s = time.monotonic() + timeout_s
        while not self._drain():
            if time.monotonic() >= deadline_s:
                return False
            time.sleep(_PAUSE_S)
        return True

    def close(self) -> None:
        for ring in self._rings.values():
            ring.close()
        self.inbox.close()

    def _drain(self) -> int:
        """Hand a ring's worth of each topic to the decoder; how many messages it was."""
        n = 0
        for topic, ring in self._rings.items():
            samples = ring.take()
            n += len(samples)
            for sample in samples:
                size = len(sample.payload)
                if size > self._max_bytes:
                    self._synchronizer.count(topic.key, "oversized", f"{size} bytes")
                else:
                    self._decoder.offer(topic, sample.payload.to_bytes())
        self.counters["overrun"] = sum(ring.overruns for ring in self._rings.values())
        return n
