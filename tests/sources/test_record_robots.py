"""`edge record` with robots on ROS 2, and with a camera over ZeroMQ."""

from __future__ import annotations

import argparse
import json
import os
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
from bags import CAMERA, DEPTH_MM, MOUNT, OPTICAL, compressed_image
from fake_zenoh import Flooded
from live_patience import eventually
from ros_router import kept, ours, router, zenoh_settings
from simulated import simulated

from edge.bus.ros2.names import RMW_ZENOH, dialect_of
from edge.bus.ros2.node import Ros2Node
from edge.bus.session import zenoh_session
from edge.bus.wire import messages
from edge.bus.wire.transforms import Transform, encode_transforms
from edge.config import Config, ZenohConfig
from edge.errors import FAILED
from edge.geometry import SE2, se3
from edge.host.ports import free_port
from edge.sources import recording
from edge.sources.played import Playback

RGB, DEPTH, INFO = "/cam/rgb/image/compressed", "/cam/depth", "/cam/info"
NAMES = {"camera/rgb": RGB, "camera/depth": DEPTH, "camera/info": INFO}
STEP_NS = 100_000_000
ENOUGH = {"/tf_static": 1, "/camera/info": 1}
"""Messages; some are lost before the others are heard, and a frame needs those around it."""


class Robot:
    """Publishes a camera, odometry and tf in a graph of ROS 2."""

    def __init__(self, session, dialect) -> None:
        self.node = node = Ros2Node(session, 0, "robot", dialect)
        self._static = (
            node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
            if dialect.has_tokens
            else kept(session, dialect, "/tf_static")
        )
        self._static.put(encode_transforms([Transform(1, "base_link", OPTICAL, MOUNT)]))
        kinds = {
            "/tf": "tf2_msgs/msg/TFMessage", "/odom": "nav_msgs/msg/Odometry",
            RGB: "sensor_msgs/msg/CompressedImage", DEPTH: "sensor_msgs/msg/Image",
            INFO: "sensor_msgs/msg/CameraInfo",
        }  # fmt: skip
        self._publishers = {topic: node.publisher(topic, kind) for topic, kind in kinds.items()}
        self._ns = 10**18

    def see(self) -> None:
        """Send one frame of everything."""
        self._ns += STEP_NS
        self.node.update()
        ns, png = self._ns, cv2.imencode(".png", np.full((12, 16, 3), 90, np.uint8))[1].tobytes()
        for topic, payload in {
            "/tf": encode_transforms([Transform(ns, "map", "odom", se3(1.0))]),
            "/odom": messages.encode_odometry(ns, SE2(0.0, 0.0, 0.0).matrix(), 0.0, 0.0),
            INFO: messages.encode_camera_info(ns, OPTICAL, CAMERA),
            DEPTH: messages.encode_image(ns, OPTICAL, DEPTH_MM),
            RGB: compressed_image(ns, OPTICAL, "rgb8; png compressed", png),
        }.items():
            self._publishers[topic].put(payload)


def record(
    session, config: Config, path: Path, enough: set[str], see: Callable[[], None]
) -> Counter:
    """Record while a robot sends, until `ENOUGH` messages of each topic were heard."""
    stop, heard = threading.Event(), Counter()

    class File(recording.McapWriter):
        def add(self, channel, *message) -> None:
            super().add(channel, *message)
            heard[channel.topic] += 1

    def sent() -> bool:
        see()
        return all(heard[topic] >= ENOUGH.get(topic, 5) for topic in enough)

    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(1) as pool:
        patch.setattr(recording, "McapWriter", File)
        writing = pool.submit(recording.record, session, config, path, 600.0, stop)
        try:
            eventually(sent, lambda: f"only {heard}")
        finally:
            stop.set()
        return writing.result()


@pytest.mark.parametrize("via", ["rmw_zenoh", "bridge", "adapter"])
def test_the_sensors_of_a_ros2_robot_are_recorded_and_play(tmp_path, via):
    path = tmp_path / "robot.mcap"
    ros2 = {"via": via, "topics": NAMES}
    config = simulated({"source": {"kind": "ros2"}, "ros2": ros2})
    dialect = dialect_of(via, config.zenoh.prefix)
    enough = {"/camera/rgb/compressed", "/camera/depth", "/camera/info", "/odom", "/tf",
              "/tf_static"}  # fmt: skip
    with router() as port, ours(port) as robot_session, ours(port) as session:
        robot = Robot(robot_session, dialect)
        written = record(session, config, path, enough, robot.see)
        robot.node.close()
    assert set(written) == enough
    with Playback(path, config, None) as playback:
        playback.check()
        source = playback.open(config, Flooded("", ()))
        seen = []
        while not source.is_over:
            if (observation := source.poll()) is not None:
                seen.append(observation)
                observation.release()
    np.testing.assert_allclose(seen[-1].T_base_camera, MOUNT, atol=1e-6)
    assert playback.matched.topics["camera/rgb"] == "/camera/rgb/compressed"


def test_a_camera_over_zeromq_is_recorded(tmp_path):
    zmq = pytest.importorskip("zmq", reason="extra `zmq` is not installed")
    where, path = f"tcp://127.0.0.1:{free_port()}", tmp_path / "robot.mcap"
    config = simulated({"source": {"kind": "zmq", "options": {"address": where}}})
    bgr = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)
    head = {"topic": "camera/rgb", "stamp": 5, "height": 12, "width": 16, "encoding": "bgr8",
            "intrinsics": [12, 12, 7.5, 5.5]}  # fmt: skip
    depth = {**head, "topic": "camera/depth", "encoding": "16UC1"}
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        socket.linger = 0
        socket.bind(where)

        def see() -> None:
            socket.send_multipart([b"no header", b""])
            socket.send_multipart([json.dumps(head).encode(), bgr.tobytes()])
            socket.send_multipart([json.dumps(depth).encode(), DEPTH_MM.tobytes()])

        enough = {"/camera/rgb", "/camera/depth", "/camera/info"}
        record(Flooded("", ()), config, path, enough, see)
    payloads = {message.topic.key: message.payload for message in recording.read(path)}
    info = messages.decode_camera_info(payloads["camera/info"])
    assert (info.stamp_ns, info.camera) == (5, CAMERA)
    for key, expected in (("camera/rgb", bgr[..., ::-1]), ("camera/depth", DEPTH_MM * 1e-3)):
        header = messages.decode_image_header(payloads[key])
        out = np.empty(expected.shape, np.uint8 if key == "camera/rgb" else np.float32)
        messages.decode_image_into(payloads[key], header, out)
        np.testing.assert_allclose(out, expected, rtol=1e-6)


def test_a_topic_of_another_type_is_not_recorded_but_logged(tmp_path, caplog):
    config = simulated({"source": {"kind": "ros2"}, "ros2": {"topics": {"odom": "/tf"}}})
    with router() as port, ours(port) as robot_session, ours(port) as session:
        robot = Robot(robot_session, RMW_ZENOH)
        written = record(session, config, tmp_path / "robot.mcap", {"/tf"}, robot.see)
        robot.node.close()
    assert "/odom" not in written
    assert "/tf: messages are not recorded: their type is tf2_msgs/msg/TFMessage, " in caplog.text


@pytest.mark.parametrize(
    ("written", "code", "said"),
    [
        ({}, 1, "nothing received at"),
        ({"/odom": 5}, 1, "nothing received from camera/depth, camera/rgb, camera/info"),
        ({"/camera/rgb": 5, "/camera/depth": 5, "/odom": 5}, 1, "received from camera/info"),
        ({"/camera/rgb/compressed": 5, "/camera/depth": 5, "/camera/info": 1, "/tf": 5}, 0, ""),
    ],
)
def test_a_recording_that_lacks_a_sensor_is_a_failure(
    tmp_path, monkeypatch, capsys, written, code, said
):
    with router() as port:
        path = tmp_path / "mine.yaml"
        zenoh = zenoh_settings(port).model_dump(mode="json")
        detector = {"detector": {"kind": "sim"}}
        path.write_text(json.dumps({"zenoh": zenoh, "perception": detector}))
        monkeypatch.setattr(recording, "record", lambda *_: Counter(written))
        args = argparse.Namespace(config=str(path), out=tmp_path / "x.mcap", seconds=1.0)
        assert recording.run(args) == code
    out = capsys.readouterr().out
    assert said in out
    assert ("nothing" in out) == (code != os.EX_OK)


@pytest.mark.parametrize("served", [False, True], ids=["no service", "a service"])
def test_a_robot_is_recorded_with_and_without_a_service(tmp_path, served):
    settings, path = ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}"), tmp_path / "mine.yaml"
    detector = {"detector": {"kind": "sim"}}
    zenoh = settings.model_dump(mode="json")
    path.write_text(json.dumps({"zenoh": zenoh, "perception": detector}))
    args = argparse.Namespace(config=str(path), out=tmp_path / "x.mcap", seconds=2.0)
    done = threading.Event()

    def send() -> None:
        with zenoh_session(settings, "connect", done) as robot:
            while not done.wait(0.05):
                robot.put(settings.key("odom"), messages.encode_odometry(1, np.eye(4), 0.0, 0.0))

    service = zenoh_session(settings, "listen") if served else nullcontext()
    with ThreadPoolExecutor(1) as pool, service:
        sent = pool.submit(send)
        try:
            assert recording.run(args) == FAILED, "the camera is missing"
        finally:
            done.set()
        sent.result()
    assert {message.topic.key for message in recording.read(args.out)} == {"odom"}
