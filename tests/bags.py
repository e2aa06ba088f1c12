"""Recordings of a robot that drives ahead and sees a wall.

Written by the libraries `mcap` and `rosbags`, and in plain SQL.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from ros_messages import STORE
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from edge.bus.wire import messages
from edge.bus.wire.cdr import U32
from edge.bus.wire.cdr import CdrWriter as CdrWriter
from edge.bus.wire.transforms import Transform, encode_transforms
from edge.geometry import SE2, CameraModel, se3, to_optical

N = 12
START_NS = 1_600_000_000_000_000_000
STEP_NS = 100_000_000
CAMERA = CameraModel(16, 12, 12.0, 12.0, 7.5, 5.5)
RGB, DEPTH, INFO = "/front/color/image_raw", "/front/depth/aligned", "/front/color/camera_info"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF = "tf2_msgs/msg/TFMessage"
OPTICAL = "front_color_optical"
MOUNT = to_optical(se3(0.2, 0.0, 0.5))
DEPTH_MM = np.full((12, 16), 2000, np.uint16)
Sent = tuple[str, str, int, bytes]
"""Topic, type (`sensor_msgs/msg/Image`), the time at which it was heard, and CDR."""


def write_mcap(
    path: Path,
    sent: Iterable[Sent],
    compression: CompressionType = CompressionType.ZSTD,
    encoding: str = "cdr",
) -> Path:
    """Write an MCAP file as `ros2 bag record` does."""
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for n, (topic, kind, time_ns, payload) in enumerate(sent):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], time_ns, payload, time_ns, n)
        writer.finish()
    return path


def write_bag(
    folder: Path,
    sent: Iterable[Sent],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    writer = BagWriter(folder, version=9, storage_plugin=storage)
    if compression != CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections: dict = {}
        for topic, kind, time_ns, payload in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time_ns, payload)
    return folder


def write_db3(path: Path, sent: Iterable[Sent], messages: str = "") -> Path:
    """Write the file alone, with rosbag2's two tables."""
    with closing(sqlite3.connect(path)) as db:
        db.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
                   "serialization_format TEXT, offered_qos_profiles TEXT)")  # fmt: skip
        db.execute(messages or "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
                   "timestamp INTEGER, data BLOB)")  # fmt: skip
        numbers: dict[str, int] = {}
        for topic, kind, time_ns, payload in sent:
            if topic not in numbers:
                numbers[topic] = len(numbers) + 1
                db.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')",
                           (numbers[topic], topic, kind))  # fmt: skip
            db.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
                       (numbers[topic], time_ns, payload))  # fmt: skip
        db.commit()
    return path


def stamps(n: int = N) -> Iterator[tuple[int, int]]:
    return ((k, START_NS + k * STEP_NS) for k in range(n))


def camera(rgb: str = RGB, depth: str = DEPTH, info: str = INFO, n: int = N) -> Iterator[Sent]:
    """Return messages of a camera that sees a wall."""
    for k, ns in stamps(n):
        described = messages.encode_camera_info(ns, OPTICAL, CAMERA)
        yield info, "sensor_msgs/msg/CameraInfo", ns, described
        yield depth, IMAGE, ns, messages.encode_image(ns, OPTICAL, DEPTH_MM)
        picture = np.random.default_rng(k).integers(0, 256, (12, 16, 3), np.uint8)
        yield rgb, IMAGE, ns, messages.encode_image(ns, OPTICAL, picture)


def x_m(k: int) -> float:
    return 0.05 * k


def odometry(
    topic: str = "/odom", frame: str = "map", child: str = "base_link", n: int = N
) -> Iterator[Sent]:
    """Return odometry of a robot that drives ahead and stops."""
    for k, ns in stamps(n):
        at = SE2(x_m(min(k, N)), 0.0, 0.0).matrix()
        payload = _renamed(messages.encode_odometry(ns, at, 0.0, 0.0), frame, child)
        yield topic, "nav_msgs/msg/Odometry", ns, payload


def _renamed(payload: bytes, frame: str, child: str) -> bytes:
    """Odometry between other frames."""
    sample = messages.decode_odometry(payload)
    writer = CdrWriter().header(sample.stamp_ns, frame).string(child)
    messages.write_pose(writer, sample.T_map_base).floats((0.0,) * 36, "d")
    return writer.floats((0.0,) * 6, "d").floats((0.0,) * 36, "d").bytes()


def static(*transforms: tuple[str, str, np.ndarray], ns: int = START_NS) -> Iterator[Sent]:
    payload = encode_transforms([Transform(ns, *t) for t in transforms])
    yield "/tf_static", TF, ns, payload


def moving(parent: str, child: str, dx_m: float = 0.0) -> Iterator[Sent]:
    """Return the transforms of a frame that moves with the robot, or stays if it is moved."""
    for k, ns in stamps():
        T = se3(dx_m) if dx_m else se3(x_m(k))
        yield "/tf", TF, ns, encode_transforms([Transform(ns, parent, child, T)])


def together(*parts: Iterator[Sent]) -> list[Sent]:
    return sorted((sent for part in parts for sent in part), key=lambda sent: sent[2])


def plain() -> list[Sent]:
    return together(odometry(), camera())


def compressed_image(stamp_ns: int, frame_id: str, words: str, data: bytes) -> bytes:
    """sensor_msgs/CompressedImage."""
    writer = CdrWriter().header(stamp_ns, frame_id).string(words).write(U32, 4, len(data))
    return writer.bytes(memoryview(data))
