"""Sensor messages of one instant: a sane robot's, and the same with one absurd number."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import messages
from edge.geometry import CameraModel

WIDTH, HEIGHT, STAMP_NS = 64, 48, 10**18
ABSURD = (
    0.0, 1e-300, 1e-30, 1e-7, -1.0, 1e3, 8.9e5, -8.9e5, 1e10, 1e18, 1e30, 3.4e38, -3.4e38, 1e300,
    -1.7e308,
)  # fmt: skip
STAMPS_NS = (-(2**31) * 10**9, -1, 0, 1, (2**31 - 1) * 10**9 + 999_999_999)

Batch = dict[Topic, bytes]


def changed(payload: bytes, code: str, before: float, after: float) -> bytes:
    """Return the payload with every number `before` replaced (float32: the nearest value)."""
    if code == "f":
        after = max(min(after, 3.4e38), -3.4e38)
    old = struct.pack(f"<{code}", before)
    assert old in payload
    return payload.replace(old, struct.pack(f"<{code}", after))


def batch(stamp_ns: int = STAMP_NS) -> Batch:
    """Return a sane robot's messages of one instant; each number that a test changes is unique."""
    pose = np.eye(4)
    pose[:3, 3] = 0.111, 0.222, 0.333
    ids = np.zeros((HEIGHT, WIDTH), np.uint16)
    ids[10:30, 10:40] = 1
    depth = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth[20:30] = 1.5
    rgb = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint32).astype(np.uint8).reshape(HEIGHT, WIDTH, 3)
    cloud = np.tile(np.array([[1.25, 2.5, -0.25]], np.float32), (50, 1))
    camera = CameraModel(WIDTH, HEIGHT, 41.5, 42.5, 31.25, 23.25)
    return {
        topics.CAMERA_INFO: messages.encode_camera_info(stamp_ns, "camera", camera),
        topics.ODOMETRY: messages.encode_odometry(stamp_ns, pose, 0.444, 0.555),
        topics.DEPTH: messages.encode_image(stamp_ns, "camera", depth),
        topics.RGB: messages.encode_image(stamp_ns, "camera", rgb),
        topics.SEGMENTATION: messages.encode_image(stamp_ns, "camera", ids),
        topics.CLOUD: messages.encode_point_cloud(stamp_ns, "lidar", cloud),
    }


def scan() -> bytes:
    ranges = np.full(50, 1.75, np.float32)
    return messages.encode_laser_scan(STAMP_NS, "lidar", -1.5, 0.0625, 12.5, ranges)


NUMBERS: list[tuple[Topic, str, float]] = [
    *((topics.CAMERA_INFO, "d", value) for value in (41.5, 42.5, 31.25, 23.25)),
    *((topics.ODOMETRY, "d", value) for value in (0.111, 0.222, 0.333, 0.444, 0.555)),
    (topics.ODOMETRY, "d", 1.0),  # the quaternion's w, the only one that is not zero
    (topics.DEPTH, "f", 1.5),
    *((topics.CLOUD, "f", value) for value in (1.25, 2.5, -0.25)),
    *((topics.SCAN, "f", value) for value in (-1.5, 0.0625, 12.5, 1.75)),
]


def batches() -> Iterator[Batch]:
    for topic, code, number in NUMBERS:
        for value in ABSURD:
            sane = batch()
            if topic is topics.SCAN:
                del sane[topics.CLOUD]
                sane[topic] = scan()
            yield {**sane, topic: changed(sane[topic], code, number, value)}
    for stamp_ns in STAMPS_NS:
        yield batch(stamp_ns)
