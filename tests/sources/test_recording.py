"""Recordings: complete or not there; readable by ROS 2 tools; played as they were heard."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from edge.bus import topics
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.geometry import SE2
from edge.sources import recording
from edge.sources.recording import McapWriter, RecordingError, read, record_messages


def drive(n: int):
    """`n` odometry samples and images, 10 ms apart, and one status of the service."""
    for k in range(n):
        stamp_ns = 1_000_000_000 + k * 10_000_000
        pose = SE2(0.1 * k, 0.0, 0.0).matrix()
        yield topics.ODOMETRY, stamp_ns, messages.encode_odometry(stamp_ns, pose, 0.0, 0.0)
        image = np.full((2, 3, 3), k, np.uint8)
        yield topics.RGB, stamp_ns, messages.encode_image(stamp_ns, "camera", image)
    yield topics.STATUS, 1_000_000_000, b'{"phase":"searching"}'


def test_an_empty_recording_is_still_a_file(tmp_path):
    path = tmp_path / "empty.mcap"
    assert record_messages(path, []) == 0
    assert list(read(path)) == []


def test_ros_tools_can_read_the_recording(tmp_path):
    path = tmp_path / "drive.mcap"
    record_messages(path, list(drive(3))[:-1])
    with AnyReader([path]) as reader:
        names = {c.topic: c.msgtype for c in reader.connections}
        assert names == {"/odom": "nav_msgs/msg/Odometry", "/camera/rgb": "sensor_msgs/msg/Image"}
        xs = [
            reader.deserialize(raw, connection.msgtype).pose.pose.position.x
            for connection, _, raw in reader.messages()
            if connection.topic == "/odom"
        ]
    assert xs == pytest.approx([0.0, 0.1, 0.2])


def test_a_recording_that_fails_leaves_nothing(tmp_path):
    path = tmp_path / "drive.mcap"
    path.write_bytes(b"the old one")

    def fails():
        yield from drive(2)
        raise RuntimeError("the simulator broke")

    with pytest.raises(RuntimeError, match="broke"):
        record_messages(path, fails())
    assert [p.name for p in tmp_path.iterdir()] == ["drive.mcap"]
    assert path.read_bytes() == b"the old one"


def test_files_that_cannot_be_used(tmp_path):
    whole = tmp_path / "whole.mcap"
    record_messages(whole, drive(50))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-100])
    (tmp_path / "junk.mcap").write_bytes(b"junk" * 100)
    (tmp_path / "nothing.mcap").write_bytes(b"")
    for name in ("cut.mcap", "junk.mcap", "nothing.mcap"):
        with pytest.raises(RecordingError, match=rf"{name}: not a complete MCAP file") as caught:
            list(read(tmp_path / name))
        assert "\n" not in str(caught.value)
    with pytest.raises(RecordingError, match="No such file"):
        list(read(tmp_path / "absent.mcap"))
    with (
        pytest.raises(RecordingError, match="cannot be written"),
        McapWriter(tmp_path / "no" / "folder.mcap"),
    ):
        pass


class Tape:
    """Fake session that keeps its messages; `full` is set at the message of that number."""

    def __init__(self, length: int) -> None:
        self.puts: list[tuple[str, bytes]] = []
        self.full = threading.Event()
        self._length = length

    def declare_publisher(self, key, **_qos):
        tape = self

        class Publisher:
            def put(self, payload):
                tape.puts.append((key, payload))
                if len(tape.puts) == tape._length:
                    tape.full.set()

            def undeclare(self):
                pass

        return Publisher()


def test_playback_sends_sensor_messages_with_new_stamps(tmp_path):
    path = tmp_path / "drive.mcap"
    record_messages(path, drive(4))
    tape = Tape(8)
    assert recording.play(tape, ZenohConfig(), path, tape.full)[0] == 8
    assert [key for key, _ in tape.puts[:2]] == ["edge/odom", "edge/camera/rgb"]
    stamps = [messages.peek_stamp_ns(payload) for _, payload in tape.puts]
    assert stamps[0] == stamps[1]
    assert np.diff(stamps[::2]).tolist() == [10_000_000] * 3
    assert stamps[0] > 1_700_000_000 * 10**9
    last = messages.decode_odometry(tape.puts[-2][1])
    assert last.T_map_base[0, 3] == pytest.approx(0.3)


@pytest.mark.parametrize(
    "payload",
    [b"\0\1\0\0\1", b"", b"\0\1\0\0\xff\xff\xff\x7f" + bytes(60)],
    ids=["short", "empty", "stamp out of range"],
)
def test_a_damaged_message_is_left_out_of_the_playback(tmp_path, payload):
    path = tmp_path / "drive.mcap"
    first, *others = drive(4)
    record_messages(path, [first, (topics.ODOMETRY, first[1], payload), *others])
    tape = Tape(8)
    sent, _, damaged = recording.play(tape, ZenohConfig(), path, tape.full)
    assert (sent, damaged) == (8, 1)


def test_ground_truth_is_played_with_the_images(tmp_path):
    """So that the detector `sim` finds it by the new stamp."""
    path, ids = tmp_path / "truth.mcap", np.ones((2, 3), np.uint16)
    picture = messages.encode_image(5, "camera", ids)
    shot = [topics.DEPTH, topics.SEGMENTATION]
    said = [(topics.LABELS, 5, b'["bed"]'), *((topic, 5, picture) for topic in shot)]
    record_messages(path, said)
    tape = Tape(3)
    recording.play(tape, ZenohConfig(topics={"sim/labels": "names"}), path, tape.full)
    assert tape.puts[0] == ("edge/names", b'["bed"]')
    assert [key for key, _ in tape.puts[1:]] == [f"edge/{topic.key}" for topic in shot]
    assert tape.puts[1][1] == tape.puts[2][1] != picture


def test_a_loop_plays_until_it_is_stopped(tmp_path):
    path = tmp_path / "drive.mcap"
    record_messages(path, drive(2))
    tape = Tape(9)
    assert recording.play(tape, ZenohConfig(), path, tape.full)[0] == len(tape.puts) == 9
    stamps = [messages.peek_stamp_ns(payload) for key, payload in tape.puts if "odom" in key]
    assert all(np.diff(stamps) > 0)


def test_a_loop_over_nothing_is_an_error(tmp_path):
    path = tmp_path / "empty.mcap"
    record_messages(path, [])
    with pytest.raises(RecordingError, match="holds no message of a sensor"):
        recording.play(Tape(1), ZenohConfig(), path, threading.Event())
