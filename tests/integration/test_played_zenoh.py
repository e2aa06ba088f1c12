"""A recording that another process plays over real Zenoh."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from live_patience import PATIENCE_S, eventually
from simulated import simulated

from edge.bus import topics
from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import Config, ZenohConfig
from edge.geometry import SE2, CameraModel
from edge.host.ports import free_port
from edge.recording.channels import Channel
from edge.sources import recording
from edge.sources.zenoh import ZenohSource

CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)


@pytest.fixture
def config() -> Config:
    return simulated(
        {
            "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
            "perception": {"detector": {"kind": "onnx"}},
            "source": {"max_message_mb": 0.1},
        }
    )


def record(session, config: Config, path: Path, enough: set[str]) -> None:
    """Record until 30 messages and these keys are in it."""
    stop, heard = threading.Event(), []

    class File(recording.McapWriter):
        def add(self, channel: Channel, *message: object) -> None:
            super().add(channel, *message)
            heard.append(channel.topic.lstrip("/"))
            if len(heard) >= 30 and enough <= set(heard):
                stop.set()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "McapWriter", File)
        written = recording.record(session, config, path, PATIENCE_S, stop)
        assert written.total() == len(heard)
    assert stop.is_set(), f"only {set(heard)}"


def test_a_recording_is_played_by_another_process(config, tmp_path):
    def drive():
        for k in range(60):
            stamp_ns = k * 16_666_667
            pose = SE2(0.01 * k, 0.0, 0.0).matrix()
            yield topics.ODOMETRY, stamp_ns, messages.encode_odometry(stamp_ns, pose, 0.5, 0.0)
            if k % 2 == 0:
                images = np.full((24, 32, 3), k, np.uint8), np.full((24, 32), 1500, np.uint16)
                for topic, image in zip((topics.RGB, topics.DEPTH), images, strict=True):
                    yield topic, stamp_ns, messages.encode_image(stamp_ns, "camera", image)
            if k % 30 == 0:
                yield (
                    topics.CAMERA_INFO,
                    stamp_ns,
                    messages.encode_camera_info(stamp_ns, "camera", CAMERA),
                )

    path = tmp_path / "drive.mcap"
    recording.record_messages(path, drive())
    again = tmp_path / "again.mcap"
    # A recording has our own names, even if the topics are renamed.
    own = ZenohConfig(
        endpoint=config.zenoh.endpoint, topics={"odom": "base/odom", "camera/rgb": "odom"}
    )
    config = config.model_copy(update={"zenoh": own})
    with open_session(config.zenoh, "listen") as session:
        source = ZenohSource(config, session)
        with recording.player(config, path) as process:
            for _ in range(10):
                seen = eventually(source.poll)
                assert seen.pose.x_m == pytest.approx(0.01 * seen.rgb[0, 0, 0], abs=1e-6)
                assert abs(time.time_ns() - seen.stamp_ns) < PATIENCE_S * 1e9
                seen.release()
            record(session, config, again, {"odom", "camera/rgb", "camera/depth"})
        assert process.returncode == 0
        source.close()
    keys = {message.topic.key for message in recording.read(again)}
    assert keys >= {"odom", "camera/rgb", "camera/depth"}
