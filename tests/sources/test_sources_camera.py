"""A camera that OpenCV opens: files and streams that come, end, stall and come again."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event

import cv2
import numpy as np
import pytest
from fake_zenoh import Flooded
from http_server import Quiet, running
from patience import eventually
from simulated import simulated

from edge.bus.wire import messages
from edge.config import Config, ConfigError
from edge.loop.source import missing_inputs
from edge.sources import camera as module
from edge.sources import find_source
from edge.sources.camera import CameraReader, CameraSource, CameraTap

HW = 48, 64
INTRINSICS = [60.0, 60.0, 31.5, 23.5]


class Robot(Flooded):
    """A session of a robot that stands still and measures depth."""

    def __init__(self) -> None:
        ticks = itertools.count()
        pose, depth_m = np.eye(4), np.full(HW, 2.0, np.float32)
        now = time.time_ns
        super().__init__("edge/odom", (messages.encode_odometry(now(), pose, 0, 0) for _ in ticks))
        seen = (messages.encode_image(now(), "camera", depth_m) for _ in ticks)
        self._depth = Flooded("edge/camera/depth", seen)

    def declare_subscriber(self, key: str, ring: object) -> Flooded:
        return self._depth if key == "edge/camera/depth" else super().declare_subscriber(key, ring)


def picture(level: int) -> np.ndarray:
    """Return an image with a blue left half, (48, 64, 3) BGR."""
    image = np.full((*HW, 3), level, np.uint8)
    image[:, :32, 0] = 255
    return image


def write_video(path: Path, n: int = 3) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, HW[::-1])
    for level in range(n):
        writer.write(picture(40 * level))
    writer.release()
    return path


def configured(path: str, **options: object) -> Config:
    given = {"address": path, "intrinsics": INTRINSICS, **options}
    return simulated({"source": {"kind": "camera", "options": given}})


@contextmanager
def source_of(config: Config) -> Iterator[CameraSource]:
    source = find_source(config)(config=config, session=Robot())
    try:
        yield source
    finally:
        source.close()


def observed(source: CameraSource):
    def look():
        source.wait(0.01)
        return source.poll()

    return eventually(look, "no observation")


@contextmanager
def reading(address: str) -> Iterator[CameraReader]:
    reader = CameraReader(address)
    try:
        yield reader
    finally:
        reader.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": ""}, r"address: ''; give a URL, a device"),
        ({"address": 0}, "address: expected a text, got 0"),
        ({"intrinsics": [1, 2, 3]}, r"intrinsics: \[1, 2, 3\]; give \[fx, fy, cx, cy\] in px"),
        ({"intrinsics": [0, 1, 2, 3]}, "intrinsics: "),
        ({"intrinsics": [1, 2, float("nan"), 3]}, "intrinsics: "),
        ({"distortion": [0.1]}, "distortion: .*; give "),
        ({"distortion": "none"}, "distortion: .*; give "),
        ({"latency_s": -1}, "latency_s: -1; give seconds, from 0 to 10"),
        ({"latency": 1}, "latency"),
    ],
)
def test_wrong_options_are_one_line(options, message):
    with pytest.raises(ConfigError, match=rf"source\.options[.:].*{message}") as raised:
        find_source(configured("rtsp://127.0.0.1:1/", **options))
    assert "\n" not in str(raised.value)


def test_a_video_file_is_played_in_a_loop(tmp_path, caplog):
    config = configured(str(write_video(tmp_path / "a.avi")), latency_s=0.05)
    with source_of(config) as source:
        before_ns = time.time_ns()
        seen = observed(source)
        assert abs(seen.stamp_ns + 50_000_000 - before_ns) < 60e9
        assert seen.rgb.shape == (*HW, 3)
        assert seen.rgb[:, :24, 2].min() > 200  # blue, the last of RGB
        assert seen.rgb[:, 40:, 2].max() < 150
        assert (seen.camera.width_px, seen.camera.fx_px) == (64, 60.0)
        assert seen.depth_m[0, 0] == 2.0
        seen.release()
        eventually(lambda: source.poll() is None and source._reader.n_images > 3, "played once")
    assert not [record for record in caplog.records if "camera" in record.name]


def test_a_missing_camera_is_reported_and_opened_later(tmp_path, caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(module, "PAUSE_S", 0.01)
    path = tmp_path / "a.avi"
    with source_of(configured(str(path))) as source:
        eventually(lambda: "cannot be opened: no such file or device" in caplog.text)
        source.poll()
        assert f"camera/rgb ({path})" in missing_inputs(source.input_table())
        write_video(tmp_path / "b.avi").rename(path)
        observed(source).release()
    reported = [record.getMessage() for record in caplog.records if "camera" in record.name]
    assert len([line for line in reported if "cannot be opened" in line]) == 1
    assert any("sends images again" in line for line in reported)


@pytest.mark.parametrize("error", [cv2.error("oh no"), MemoryError("oh no"), SystemError("oh no")])
def test_an_error_of_a_read_is_reported_and_the_camera_opened_again(tmp_path, error, monkeypatch,
                                                                    caplog):  # fmt: skip
    monkeypatch.setattr(module, "PAUSE_S", 0.01)
    errors, open_capture = [error], cv2.VideoCapture

    def fail_once(*arguments):
        if errors:
            raise errors.pop()
        return open_capture(*arguments)

    monkeypatch.setattr(cv2, "VideoCapture", fail_once)
    with reading(str(write_video(tmp_path / "a.avi"))) as reader:
        eventually(reader.take, patience_s=10.0)
    assert "cannot be read: oh no" in caplog.text


class Stream(Quiet):
    """Motion JPEG over HTTP: three images, then as `then` says."""

    then, stopping = "end", Event()

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        for n in range(3 if self.then != "go on" else 10_000):
            data = cv2.imencode(".jpg", picture(n))[1].tobytes()
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + data + b"\r\n")
            except ConnectionError:
                return
            self.stopping.wait(0.02)
        if self.then == "stall":
            self.stopping.wait()


@pytest.mark.parametrize("then", ["end", "stall"])
def test_a_lost_stream_is_reported_and_reopened(then, caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(module, "PAUSE_S", 0.01)
    monkeypatch.setattr(module, "STALL_S", 0.5)

    class Here(Stream):
        stopping = Event()

    Here.then = then
    with running(Here, Here.stopping) as url, reading(f"{url}/?secret=swordfish") as reader:

        def reported() -> bool:
            reader.take()
            return "; opening it again and again" in caplog.text

        eventually(reported, "nothing reported")
        Here.then = "go on"
        many = reader.n_images + 20
        eventually(lambda: reader.n_images > many, "it was not opened again")
        eventually(lambda: "sends images again" in caplog.text)
        image = eventually(reader.take)[1]
        assert image.shape == (*HW, 3)
    assert "swordfish" not in caplog.text


def test_a_recording_has_the_images_and_their_camera(tmp_path):
    tap = CameraTap(configured(str(write_video(tmp_path / "a.avi"))))
    try:
        taken = eventually(lambda: dict(tap.take()))
    finally:
        tap.close()
    assert {channel.topic for channel in taken} == {"/camera/info", "/camera/rgb"}
