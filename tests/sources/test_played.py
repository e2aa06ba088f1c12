"""Recordings of robots: whatever file they are, whatever their topics and frames are called."""

from __future__ import annotations

import random
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from bags import (
    CAMERA,
    COMPRESSED,
    DEPTH,
    DEPTH_MM,
    INFO,
    MOUNT,
    OPTICAL,
    RGB,
    START_NS,
    STEP_NS,
    N,
    Sent,
    camera,
    compressed_image,
    moving,
    odometry,
    plain,
    stamps,
    static,
    together,
    write_bag,
    write_db3,
    write_mcap,
    x_m,
)  # fmt: skip
from fake_zenoh import Flooded
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from simulated import simulated

from edge.bus.wire import messages
from edge.config import Config
from edge.errors import Stopped
from edge.geometry import se3
from edge.recording import bag
from edge.recording.file import RecordingError
from edge.sources import played
from edge.sources.played import Playback
from edge.types import Observation

CONFIG = simulated({"perception": {"detector": {"kind": "sim"}}})


class Seen(SimpleNamespace):
    """The observations of a recording, and all log lines."""


def play(path: Path, config: Config = CONFIG, rate: float | None = None) -> Seen:
    seen: list[Observation] = []
    with Playback(path, config, rate) as playback:
        playback.check()
        source = playback.open(config, Flooded("", ()))
        while not source.is_over:
            if (observation := source.poll()) is not None:
                seen.append(replace(observation, rgb=None, depth_m=None))
                observation.release()
        source.close()
        lines = [*playback.describe_contents(), *playback.describe_outcome()]
    return Seen(
        observations=seen, stamps=[o.stamp_ns for o in seen], matched=playback.matched,
        lines="\n".join(lines), counters=source.counters, notes=playback.bag.notes,
    )  # fmt: skip


def attempt(path: Path) -> tuple[Seen | None, str]:
    """Play a file that may be damaged; return why it was refused, if it was."""
    try:
        return play(path), ""
    except RecordingError as error:
        return None, str(error)


EVERY = [ns for _, ns in stamps()]


@pytest.mark.parametrize("write", [write_mcap, write_bag, write_db3])
def test_an_empty_recording_is_an_error(tmp_path, write):
    with pytest.raises(
        RecordingError, match=r"searched for camera/rgb, .* the recording has no topics"
    ):
        play(write(tmp_path / "empty", []))


def _unnamed(folder: Path, sent: list[Sent]) -> Path:
    (write_bag(folder, sent) / "metadata.yaml").unlink()
    return folder


def _one_topic_after_the_other(path: Path, sent: list[Sent]) -> Path:
    """Heard over a minute, so that a topic's end is far from the next one's beginning."""
    slow = [
        (topic, kind, START_NS + 50 * (ns - START_NS), payload) for topic, kind, ns, payload in sent
    ]
    return write_mcap(path, sorted(slow, key=lambda one: one[0]))


@pytest.mark.parametrize(
    "write",
    [
        lambda path, sent: write_mcap(path, sent, CompressionType.NONE),
        lambda path, sent: write_mcap(path, sent, CompressionType.LZ4),
        lambda path, sent: write_mcap(path, sent, CompressionType.ZSTD),
        _one_topic_after_the_other,
        write_db3,
        write_bag,
        lambda path, sent: write_bag(path, sent) / "metadata.yaml",
        lambda path, sent: write_bag(path, sent, StoragePlugin.MCAP),
        lambda path, sent: write_bag(path, sent, compression=CompressionMode.FILE),
        lambda path, sent: write_bag(path, sent, compression=CompressionMode.MESSAGE),
        _unnamed,
    ],
    ids=["mcap", "lz4", "zstd", "unsorted", "db3", "folder", "metadata", "folder of mcap",
         "compressed file", "compressed messages", "no metadata"],
)  # fmt: skip
def test_each_kind_of_file_plays(tmp_path, write):
    seen = play(write(tmp_path / "robot", plain()))
    assert seen.stamps == EVERY
    assert [o.pose.x_m for o in seen.observations] == pytest.approx([x_m(k) for k in range(N)])


def _png(
    topic: str, ending: str, words: str, array: np.ndarray, head: bytes = b""
) -> Iterator[Sent]:
    for _, ns in stamps():
        data = head + cv2.imencode(".png", array)[1].tobytes()
        yield f"{topic}{ending}", COMPRESSED, ns, compressed_image(ns, OPTICAL, words, data)


def _info(topic: str) -> Iterator[Sent]:
    for _, ns in stamps():
        info = messages.encode_camera_info(ns, OPTICAL, CAMERA)
        yield topic, "sensor_msgs/msg/CameraInfo", ns, info


GREY = np.full((12, 16, 3), 90, np.uint8)
NAMES: dict[str, tuple[list[Sent], dict[str, str], dict[str, str]]] = {
    "ours": (
        together(odometry(), camera("/camera/rgb", "/camera/depth", "/camera/info")),
        {},
        {"camera/rgb": "/camera/rgb", "camera/depth": "/camera/depth", "odom": "/odom"},
    ),
    "of drivers": (
        together(
            odometry("/rover/odometry/filtered"), odometry("/rover/gps/odom"), camera(),
            camera("/rear/color/image_raw", "/rear/depth/aligned", "/rear/color/camera_info"),
        ),
        {},
        {"camera/rgb": RGB, "camera/depth": DEPTH, "camera/info": INFO,
         "odom": "/rover/odometry/filtered"},
    ),
    "configured": (
        together(odometry(), camera(), camera("/rear/a", "/rear/b", "/rear/c")),
        {"camera/rgb": "/rear/a", "camera/depth": "/rear/b", "camera/info": "/rear/c"},
        {"camera/rgb": "/rear/a", "camera/depth": "/rear/b", "camera/info": "/rear/c"},
    ),
    "configured, but not there": (
        plain(), {"camera/rgb": "/other/image"}, {"camera/rgb": RGB},
    ),
    "compressed": (
        together(
            odometry(), _info("/cam/camera_info"),
            _png("/cam/image", "/compressed", "rgb8; png compressed", GREY),
            _png("/cam/distances", "/compressedDepth", "16UC1; compressedDepth png", DEPTH_MM,
                 bytes(12)),
        ),
        {},
        {"camera/rgb": "/cam/image/compressed", "camera/depth": "/cam/distances/compressedDepth",
         "camera/info": "/cam/camera_info"},
    ),
    "masks": (
        together(odometry("/odometry"), camera("/b/image_raw", "/b/range"),
                 camera("/z/mask/image_raw", "/z/confidence"), odometry("/z/gps/odometry")),
        {},
        {"camera/rgb": "/b/image_raw", "camera/depth": "/b/range", "odom": "/odometry"},
    ),
    "known by what they hold": (
        together(odometry("/a"), camera("/b", "/c", "/d")),
        {},
        {"odom": "/a", "camera/rgb": "/b", "camera/depth": "/c", "camera/info": "/d"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_topics_are_found_and_listed(tmp_path, name):
    sent, configured, found = NAMES[name]
    config = simulated({"ros2": {"topics": configured}})
    seen = play(write_mcap(tmp_path / "robot.mcap", sent), config)
    assert seen.stamps == EVERY
    assert {name: seen.matched.topics[name] for name in found} == found
    for ours, topic in found.items():
        assert any(line.split()[:2] == [ours, topic] for line in seen.lines.splitlines())


BASE, FOOT = ("base_link", OPTICAL, MOUNT), ("base_footprint", "base_link", se3(z_m=0.1))
FRAMES: dict[str, tuple[list[Sent], float, str]] = {
    # The messages, x in the map at first, and the log line.
    "no tf": (plain(), 0.0, "no tf in the recording"),
    "map from odom": (
        together(odometry(frame="odom"), camera(), static(BASE), moving("map", "odom", 3.0)),
        3.0, "base_link in map, by tf",
    ),
    "no map": (
        together(odometry(frame="odom"), camera(), static(BASE)), 0.0,
        "map: odom instead of ros2.map_frame (map)",
    ),
    "another base": (
        together(odometry(child="chassis"), camera(), static(("chassis", OPTICAL, MOUNT))), 0.0,
        "base: chassis instead of ros2.base_frame (base_link)",
    ),
    "poses by tf": (
        together(camera(), static(BASE, FOOT), moving("odom", "base_footprint"),
                 moving("map", "odom", 3.0)),
        3.0, "tf, of base_footprint",
    ),
    "odometry elsewhere": (
        together(odometry(frame="visual"), camera(), static(BASE), moving("map", "base_link")),
        0.0, "tf does not connect visual with map",
    ),
    "handheld": (
        together(camera(), static(("kinect", OPTICAL, MOUNT)), moving("world", "kinect")), 0.0,
        "base: kinect instead of ros2.base_frame (base_link)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_found_and_listed(tmp_path, name):
    sent, first_m, told = FRAMES[name]
    camera = {"x_m": 0.2, "z_m": 0.5, "pitch_deg": 0}
    config = simulated({"sensors": {"camera": camera}})
    seen = play(write_mcap(tmp_path / "robot.mcap", sent), config)
    assert told in seen.lines
    assert len(seen.stamps) >= N - 1
    xs_m = [o.pose.x_m for o in seen.observations]
    assert xs_m == pytest.approx([first_m + (ns - START_NS) / STEP_NS * 0.05 for ns in seen.stamps])
    for observation in seen.observations:
        np.testing.assert_allclose(observation.T_base_camera, MOUNT, atol=1e-6)


def test_sensors_missing_in_tf_use_the_configured_mount(tmp_path):
    sent = together(odometry(frame="odom"), camera(), moving("map", "odom", 1.0))
    seen = play(write_mcap(tmp_path / "robot.mcap", sent))
    assert f"tf does not connect base_link with {OPTICAL}" in seen.lines
    expected = CONFIG.sensors.camera.T_base_camera()
    np.testing.assert_allclose(seen.observations[-1].T_base_camera, expected)


@pytest.mark.parametrize(
    ("cloud", "used"), [("", {"lidar/scan": "/base/scan"}), ("/rig", {"lidar/points": "/rig"})]
)
def test_one_lidar_maps(tmp_path, cloud, used):
    def scans() -> Iterator[Sent]:
        for _, ns in stamps():
            ranges = np.full(8, 2.0, np.float32)
            scan = messages.encode_laser_scan(ns, "laser", -1.0, 0.25, 10.0, ranges)
            yield "/base/scan", "sensor_msgs/msg/LaserScan", ns, scan
            yield "/base/scan_rear", "sensor_msgs/msg/LaserScan", ns, scan
            if cloud:
                points = messages.encode_point_cloud(ns, "rig", np.ones((9, 3), np.float32))
                yield cloud, "sensor_msgs/msg/PointCloud2", ns, points

    config = simulated(
        {"mapping": {"input": "cloud"}, "sensors": {"lidar": {"z_m": 0.3}},
         "perception": {"back_projection": "cloud"}}
    )  # fmt: skip
    seen = play(write_db3(tmp_path / "robot.db3", together(odometry(), scans())), config)
    assert {n: t for n, t in seen.matched.topics.items() if n.startswith("lidar")} == used
    assert "/base/scan_rear" in seen.lines.partition("not used: ")[2]
    assert len(seen.stamps) == N


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (
            together(odometry()),
            "found no camera/depth, camera/rgb, camera/info; the recording has /odom",
        ),
        (together(camera()), "found no odom; the recording has"),
        (
            [("/imu", "sensor_msgs/msg/Imu", 5, bytes(8))],
            r"the recording has /imu \(sensor_msgs/msg/Imu, 1",
        ),
    ],
)
def test_the_error_lists_missing_and_present_topics(tmp_path, sent, why):
    with pytest.raises(RecordingError, match=why) as caught:
        play(write_mcap(tmp_path / "robot.mcap", sent))
    assert "searched for camera/rgb, camera/depth, camera/info, odom" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_final_error_lists_unusable_messages(tmp_path):
    config = simulated({"ros2": {"mounts": "tf"}})
    sent = together(odometry(frame=""), camera(), static(BASE))
    with pytest.raises(RecordingError, match=r"dropped .*odom \(/odom\): 12 no_transform"):
        play(write_mcap(tmp_path / "robot.mcap", sent), config)


def test_bad_messages_are_counted_and_skipped(tmp_path):
    sent = plain()
    bad = [(topic, kind, ns, payload[:30]) for topic, kind, ns, payload in sent[:4]]
    seen = play(write_mcap(tmp_path / "robot.mcap", [*bad, *sent]))
    assert len(seen.stamps) >= N - 1
    assert seen.counters["malformed"] == 4


# -- damage -------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", [write_mcap, write_db3])
@pytest.mark.parametrize("left", [0.02, 0.3, 0.7, 0.97, -9, -1])
def test_a_cut_off_file_plays_or_is_refused(tmp_path, write, left):
    whole = write(tmp_path / "whole", plain()).read_bytes()
    path = tmp_path / "cut"
    path.write_bytes(whole[: int(left * len(whole)) if left > 0 else int(left)])
    seen, why = attempt(path)
    assert "\n" not in why
    if seen is None:
        assert re.search("cut off|damaged|malformed|not a rosbag2 file", why)
    if seen is not None and seen.stamps != EVERY:
        assert seen.notes[0] in seen.lines
    if left < 0:  # all messages are there
        assert seen is not None
        assert seen.stamps == EVERY


@pytest.mark.parametrize("write", [write_mcap, write_db3])
def test_a_damaged_file_raises_only_recording_errors(tmp_path, write):
    whole, path = write(tmp_path / "whole", plain()).read_bytes(), tmp_path / "damaged"
    rng = random.Random(3)
    for _ in range(40):
        data = bytearray(whole)
        for _ in range(rng.choice([1, 10, 300])):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(data)
        assert "\n" not in attempt(path)[1]


def _folder(path: Path, *files: str) -> Path:
    path.mkdir()
    for file in files:
        (path / file).write_bytes(b"")
    return path


def _metadata(path: Path) -> Path:
    write_bag(path, plain())
    next(path.glob("*.db3")).unlink()
    return path


def _view(path: Path) -> Path:
    endless = (
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id FROM n) "
        "SELECT id, 1 AS topic_id, 1 AS timestamp, x'00' AS data FROM n"
    )
    return write_db3(path, [], endless)


def _computed(path: Path) -> Path:
    table = (
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB AS (zeroblob(900000000)))"
    )
    return write_db3(path, [], table)


def _bytes(data: bytes):
    def write(path: Path) -> Path:
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize(
    ("write", "why"),
    [
        (lambda path: path, "no such file"),
        (_bytes(b""), "empty"),
        (_bytes(b"junk" * 100), "neither an MCAP file nor a rosbag2 file"),
        (_bytes(b"#ROSBAG V2.0\n"), "a ROS 1 bag: convert it first"),
        (_bytes(b"SQLite format 3\0" + bytes(200)), "not a rosbag2 file"),
        (_bytes(b"\x28\xb5\x2f\xfdjunk"), "empty"),
        (_folder, "no recording in this folder"),
        (lambda path: _folder(path, "a.txt"), "no recording in this folder"),
        (lambda path: _folder(path, "a_0.mcap"), "a_0.mcap: empty"),
        (_metadata, "no recording in this folder"),
        (_view, "no usable table messages"),
        (_computed, "no usable table messages"),
    ],
)
def test_a_file_that_is_not_a_recording_is_refused(tmp_path, write, why):
    with pytest.raises(RecordingError, match=why) as caught:
        play(write(tmp_path / "robot"))
    assert "\n" not in str(caught.value)


def test_a_folder_plays_without_the_files_that_are_missing(tmp_path):
    folder = write_bag(tmp_path / "robot", plain())
    metadata = folder / "metadata.yaml"
    name = next(folder.glob("*.db3")).name
    metadata.write_text(metadata.read_text().replace(f"- {name}", f"- ../{name}\n  - gone.db3"))
    seen = play(folder)
    assert seen.stamps == EVERY
    assert "names gone.db3, but there is no such file" in seen.lines


@pytest.mark.parametrize("data", [b"", b"SQLite format 3\0" + bytes(500)])
def test_a_folder_plays_without_the_files_that_are_damaged(tmp_path, data):
    folder = write_bag(tmp_path / "robot", plain())
    (folder / "metadata.yaml").unlink()
    (folder / "robot_10.db3").write_bytes(data)
    seen = play(folder)
    assert seen.stamps == EVERY
    assert "robot_10.db3: " in seen.lines
    for path in folder.glob("robot*"):
        path.write_bytes(data)
    with pytest.raises(RecordingError):
        play(folder)


def test_nothing_is_decompressed_beyond_its_limit(tmp_path, monkeypatch):
    folder = write_bag(tmp_path / "a", plain(), compression=CompressionMode.MESSAGE)
    packed = write_bag(tmp_path / "b", plain(), compression=CompressionMode.FILE)
    plain_db3 = write_db3(tmp_path / "c", plain())
    monkeypatch.setattr(bag, "MAX_RECORD_BYTES", 500)
    for path in (folder, plain_db3):
        with pytest.raises(RecordingError, match="found no camera/depth"):
            play(path)
    monkeypatch.setattr(bag.shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.raises(RecordingError, match="when decompressed"):
        play(packed)


# -- in real time -------------------------------------------------------------------------------


class Clock(SimpleNamespace):
    """A clock that goes on by 10 ms at each look."""

    now_ns = 0

    def monotonic_ns(self) -> int:
        self.now_ns += 10_000_000
        return self.now_ns


def test_little_is_read_ahead(tmp_path, monkeypatch):
    monkeypatch.setattr(played, "_AHEAD_BYTES", 1)
    path = write_mcap(tmp_path / "robot.mcap", plain())
    monkeypatch.setattr(played.time, "monotonic_ns", Clock().monotonic_ns)
    assert play(path, rate=1.0).stamps == EVERY
    with Playback(path, CONFIG, 1.0) as playback:
        playback.open(CONFIG, Flooded("", ())).close()  # long before its end
    assert "recording" not in {thread.name for thread in threading.enumerate()}


def test_reading_is_broken_off(tmp_path):
    stop = threading.Event()
    stop.set()
    path = write_mcap(tmp_path / "robot.mcap", plain())
    with pytest.raises(Stopped), Playback(path, CONFIG, None, stop):
        pass


def test_late_frames_are_dropped_and_pauses_skipped(tmp_path, monkeypatch):
    clock = Clock()
    monkeypatch.setattr(played.time, "monotonic_ns", clock.monotonic_ns)
    pause_ns = 3600 * 10**9
    sent = [(topic, kind, ns + pause_ns * (k >= len(plain()) // 2), payload)
            for k, (topic, kind, ns, payload) in enumerate(plain())]  # fmt: skip
    path = write_mcap(tmp_path / "robot.mcap", sent)
    seen = play(path, rate=40.0)
    assert 2 < len(seen.stamps) < N
    assert seen.stamps[-1] == EVERY[-1]
    assert clock.now_ns < 10**9
