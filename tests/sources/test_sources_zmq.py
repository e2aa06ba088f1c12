"""A camera over ZeroMQ, through real sockets: docs/cameras.md word for word, and bad frames."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from fake_zenoh import Flooded
from live_patience import eventually
from simulated import simulated

from edge.bus.session import zenoh_session
from edge.bus.wire import clouds, messages
from edge.config import Config
from edge.config.yaml_text import parse_yaml
from edge.geometry import CameraModel
from edge.host.ports import free_port
from edge.loop.source import missing_inputs
from edge.sources import find_source
from edge.sources.zmq import ZmqSource, ZmqTap, _bus_messages, parse_header
from edge.types import Observation

zmq = pytest.importorskip("zmq", reason="extra `zmq` is not installed")
PAGE = (Path(__file__).parents[2] / "docs" / "cameras.md").read_text("utf-8")
MAX_LINES = 15
STAMP_NS = 5_000_000_000
RGB = {"topic": "camera/rgb", "stamp": STAMP_NS, "height": 16, "width": 32, "encoding": "bgr8"}
DEPTH = {**RGB, "topic": "camera/depth", "encoding": "16UC1"}
CAMERA = {"intrinsics": [30, 30.0, 15.5, 7.5]}


def address() -> str:
    return f"tcp/127.0.0.1:{free_port()}".replace("/", "://", 1)


@contextmanager
def camera_at(where: str) -> Iterator[Callable[..., None]]:
    """Send the parts of a message: headers as JSON, bytes as they are."""
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        socket.linger = 0
        socket.bind(where)
        yield lambda *parts: socket.send_multipart(
            [json.dumps(part).encode() if isinstance(part, dict) else part for part in parts]
        )


@contextmanager
def source_of(config: Config, session: object) -> Iterator[ZmqSource]:
    source = find_source(config)(config=config, session=session)
    try:
        yield source
    finally:
        source.close()


def configured(where: str, **sections: object) -> Config:
    source = {"kind": "zmq", "options": {"address": where}, "max_message_mb": 1.0}
    return simulated({"source": source, **sections})


def standing() -> Flooded:
    """Open a session that sends odometry only, before and after `STAMP_NS`."""
    stamps_ns = (STAMP_NS - 10_000_000, STAMP_NS + 10_000_000)
    return Flooded("edge/odom", [messages.encode_odometry(t, np.eye(4), 0, 0) for t in stamps_ns])


def observed(source: ZmqSource, send: Callable[[], None]) -> Observation:
    """Return the first observation; resend until the source has found the camera."""

    def look() -> Observation | None:
        send()
        source.wait(0.05)
        return source.poll()

    return eventually(look, "no observation")


def test_colour_and_depth_arrive_unchanged():
    where, rng = address(), np.random.default_rng(0)
    bgr = rng.integers(0, 255, (16, 32, 3), np.uint8)
    depth_mm = rng.integers(400, 4000, (16, 32), np.uint16)
    with camera_at(where) as send, source_of(configured(where), standing()) as source:

        def frame() -> None:
            send({**RGB, **CAMERA}, bgr.tobytes())
            send(DEPTH, depth_mm.tobytes())

        seen = observed(source, frame)
        assert seen.stamp_ns == STAMP_NS
        assert seen.camera == CameraModel(32, 16, 30, 30, 15.5, 7.5)
        np.testing.assert_array_equal(seen.rgb, bgr[..., ::-1])
        np.testing.assert_allclose(seen.depth_m, depth_mm * 1e-3, rtol=1e-6)
        seen.release()


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        (
            (b"",),
            "every message on camera/rgb ({0}) is dropped: malformed (expected two message parts",
        ),
        ((RGB, bytes(1536)), "no message yet on camera/depth ({0}), camera/info ({0})"),
    ],
)
def test_missing_camera_inputs_are_named_with_their_address(parts, said):
    where = address()
    with source_of(configured(where), standing()) as source:
        source.poll()
        every = ", ".join(f"camera/{name} ({where})" for name in ("rgb", "depth", "info"))
        assert missing_inputs(source.input_table()) == f"no message yet on {every}"
        with camera_at(where) as send:

            def told() -> bool:
                send(*parts)
                source.wait(0.05)
                source.poll()
                return said.format(where) in missing_inputs(source.input_table())

            eventually(told)


BAD = [
    ((b"",), "expected two message parts, header and pixels, got 1"),
    ((b"", b""), "empty|JSON"),
    ((b"\xff\x00" * 9, b""), "JSON|UTF"),
    ((b"{" * 5000, b""), "header has 5000 bytes, at most 4096"),
    ((RGB, b"\0" * 5), "32x16 bgr8 is 1536 bytes, got 5"),
    (({**RGB, "height": 10**12}, b"\0" * 1536), "bgr8 is 96000000000000 bytes, got 1536"),
    (({**RGB, "height": -1}, b""), "height: expected an integer, got -1"),
    (({**RGB, "stamp": 0.5}, b""), "stamp: expected an integer, got 0.5"),
    (({**RGB, "topic": "odom"}, b""), r"topic: unknown 'odom' \(choices: camera/rgb, camera/depth"),
    (({**RGB, "encoding": "jpeg"}, b""), r"encoding: unknown 'jpeg' \(choices: rgb8"),
    (({**RGB, "topic": []}, b""), r"topic: unknown \[\] \(choices"),
    (({**RGB, "encoding": {}}, b""), r"encoding: unknown \{\} \(choices"),
    (({**RGB, "topc": 1}, b""), r"unknown field 'topc' \(choices: topic, stamp"),
    (({**RGB, "intrinsics": [1, 2]}, b"\0" * 1536), r"intrinsics: expected \[fx, fy, cx, cy\]"),
    (({**RGB, "intrinsics": [10**400] * 4}, b"\0" * 1536), r"intrinsics: expected"),
    (({**RGB, "intrinsics": [0, 0, 0, 0]}, b"\0" * 1536), "focal|camera|fx"),
]


@pytest.mark.parametrize(("parts", "said"), BAD)
def test_a_bad_frame_is_logged_in_one_line_and_counted(parts, said, caplog):
    where = address()
    with camera_at(where) as send, source_of(configured(where), standing()) as source:

        def dropped() -> bool:
            send(*parts)
            source.wait(0.05)
            assert source.poll() is None
            return source.counters["malformed"] > 0

        eventually(dropped)
    (line,) = (m for m in caplog.messages if "malformed" in m)
    assert where in line
    assert re.search(said, line), line
    assert "\n" not in line


def test_an_oversized_message_is_refused_and_logged_once(caplog):
    where = address()
    with camera_at(where) as send, source_of(configured(where), standing()) as source:

        def told() -> bool:
            send(RGB, bytes(1_000_001))
            source.wait(0.05)
            return any("sent more than 1 MB (source.max_message_mb)" in m for m in caplog.messages)

        eventually(told)
        assert source.counters["malformed"] == 0
        before = source.counters["received"]
        eventually(lambda: (send(RGB, b""), source.wait(0.05), source.counters["received"])[-1]
                   > before, "not found again")  # fmt: skip
    assert sum("the camera disconnected" in m for m in caplog.messages) == 1


def test_recording_goes_on_after_an_oversized_message():
    where = address()
    tap = ZmqTap(configured(where))
    with camera_at(where) as send:

        def taken(size: int) -> int:
            send({**RGB, "height": size // 96}, bytes(size))
            time.sleep(0.05)
            return len(list(tap.take()))

        eventually(lambda: taken(1536))
        for _ in range(3):
            taken(1_056_000)
        time.sleep(0.1)
        assert taken(1_056_000) == 0
        eventually(lambda: taken(1536), "not found again")
    tap.close()


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [("16UC1", np.array([[2000, 65535]], "<u2")), ("32FC1", np.array([[2.0, np.nan]], "<f4"))],
)
@pytest.mark.parametrize("unit_m", [None, 0.0001])
def test_recorded_depth_is_replayed_in_the_same_metres(encoding, pixels, unit_m):
    header = {**DEPTH, "height": 1, "width": 2, "encoding": encoding}
    head = json.dumps(header).encode()
    live, replayed = np.zeros((2, 1, 2), np.float32)
    image = parse_header(head, pixels.nbytes).image
    messages.decode_image_into(pixels.tobytes(), image, live, unit_m)
    ((_, payload),) = _bus_messages(head, pixels.tobytes())
    image = messages.decode_image_header(payload)
    assert image.encoding == encoding
    messages.decode_image_into(payload, image, replayed, unit_m)
    np.testing.assert_array_equal(replayed, live)


def test_a_host_without_an_address_is_logged(caplog):
    config = configured("tcp://no.such.host.invalid:5555")
    source = find_source(config)(config=config, session=standing())
    eventually(lambda: "no address is known for 'no.such.host.invalid'" in caplog.text)
    source.close()


def test_the_publisher_of_the_page_works_with_a_lidar(tmp_path):
    code, section, *_ = re.findall(r"```(?:python|yaml)\n(.*?)```", PAGE, re.DOTALL)
    assert len([line for line in code.splitlines() if line]) <= MAX_LINES
    (tmp_path / "publisher.py").write_text(code, "utf-8")
    film = cv2.VideoWriter(
        str(tmp_path / "film.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48)
    )
    for _ in range(300):
        film.write(np.full((48, 64, 3), (20, 60, 200), np.uint8))
    film.release()
    where = address()
    source = {**parse_yaml(section)["source"], "options": {"address": where}}
    config = simulated({
        "source": source, "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        "mapping": {"input": "cloud"}, "perception": {"back_projection": "cloud"},
        "sensors": {"lidar": {}},
    })  # fmt: skip
    command = [sys.executable, str(tmp_path / "publisher.py"), where, str(tmp_path / "film.avi")]
    with zenoh_session(config.zenoh, "listen") as session, source_of(config, session) as made:
        stop = threading.Event()
        robot = threading.Thread(target=drive, args=(config, stop))
        robot.start()
        try:
            seen = eventually(lambda: pictured(made, command), "no picture")
        finally:
            stop.set()
            robot.join()
    assert seen.rgb.shape == (48, 64, 3)
    np.testing.assert_allclose(seen.rgb.reshape(-1, 3).mean(axis=0), (200, 60, 20), atol=6)
    assert seen.camera.fx_px == pytest.approx(0.9 * 64)
    assert len(seen.cloud_m) == 50


def drive(config: Config, stop: threading.Event) -> None:
    """Odometry and a LiDAR's clouds, ten a second, from another session."""
    points = np.ones((50, 3), np.float32)
    with zenoh_session(config.zenoh, "connect", stop) as session:
        while not stop.wait(0.02):
            now_ns = time.time_ns()
            odometry = messages.encode_odometry(now_ns, np.eye(4), 0.0, 0.0)
            session.put(config.zenoh.key("odom"), odometry)
            cloud = clouds.encode_point_cloud(now_ns, "lidar", points)
            session.put(config.zenoh.key("lidar/points"), cloud)


def pictured(source: ZmqSource, command: list[str]) -> Observation | None:
    """Return an observation with an image, if this playback has one."""
    with subprocess.Popen(command, env=os.environ) as publisher:
        while publisher.poll() is None:
            source.wait(0.02)
            seen = source.poll()
            if seen is not None and seen.rgb is not None:
                publisher.kill()
                return seen
            if seen is not None:
                seen.release()
    assert publisher.returncode == 0
    return None
