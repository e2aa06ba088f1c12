"""Recordings of robots, written by the libraries `mcap` and `rosbags`, and by SQL alone."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from ros_messages import STORE
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

Sent = tuple[str, str, int, bytes]
"""Topic, type (`sensor_msgs/msg/Image`), the time at which it was heard, and CDR."""


def write_mcap(
    path: Path, sent: Iterable[Sent], compression: CompressionType = CompressionType.ZSTD
) -> Path:
    """As `ros2 bag record` writes it."""
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for n, (topic, kind, time_ns, payload) in enumerate(sent):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time_ns, payload, time_ns, n)
        writer.finish()
    return path


def write_bag(
    folder: Path,
    sent: Iterable[Sent],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """A rosbag2 folder."""
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
    """Only the file, with rosbag2's two tables.

    Args:
        messages: SQL that makes `messages`, in place of the usual table.
    """
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
