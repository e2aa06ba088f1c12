"""A head that pans and a map that turns under odometry: both are those of the frame's stamp."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import simulated
from test_sources_synchronizer import CAMERA, CLOUD, MS, ONNX

from edge.bus import topics
from edge.bus.wire import messages
from edge.bus.wire.transforms import Transform, encode_transforms
from edge.geometry import se2_of, se3
from edge.sources.decoder import CdrDecoder
from edge.sources.synchronizer import TimeSynchronizer
from edge.sources.tf import RobotFrames

BEGIN_NS = 10**12
PAN_RADPS, MAP_RADPS = 1.0, -0.8
LIFE_MS = 3000


class Head:
    """A robot in tf that stands in `odom` and feeds a synchronizer on a clock of its own."""

    def __init__(self, late_ms: dict[str, int], hz: dict[str, int], data: dict = ONNX) -> None:
        config = simulated({**data, "source": {"kind": "ros2"}})
        self.now_ns, clock = BEGIN_NS, lambda: self.now_ns
        self.frames = RobotFrames(config)
        self.synchronizer = TimeSynchronizer(config, clock, self.frames.mount_at)
        self.decoder = CdrDecoder(self.synchronizer, clock, self.frames)
        self._leads_cloud = "mapping" in data
        self.decoder.offer(topics.CAMERA_INFO, messages.encode_camera_info(1, "eye", CAMERA))
        static = [Transform(0, "pan", "eye", np.eye(4)), Transform(0, "pan", "lidar", np.eye(4))]
        self.frames.take(encode_transforms(static), static=True)
        hz = {"frames": 30, "odom": 50, "pan": 50, "map": 50, **hz}
        self._arrivals = sorted(
            (stamp_ms + late_ms.get(name, 0), name, stamp_ms)
            for name, rate in hz.items()
            for stamp_ms in (range(0, LIFE_MS, 1000 // rate) if rate else [0])
        )

    def live(self) -> list:
        seen = []
        for at_ms, name, stamp_ms in self._arrivals:
            self.now_ns = BEGIN_NS + at_ms * MS
            self._send(name, BEGIN_NS + stamp_ms * MS)
            self.decoder.convert_waiting_poses()
            if (observation := self.synchronizer.poll()) is not None:
                observation.release()
                seen.append(observation)
        return seen

    def _send(self, name: str, stamp_ns: int) -> None:
        s = (stamp_ns - BEGIN_NS) * 1e-9
        if name == "pan":
            self._move(stamp_ns, "base_link", "pan", PAN_RADPS * s)
        elif name == "map":
            self._move(stamp_ns, "map", "odom", MAP_RADPS * s)
        elif name == "odom":
            # `encode_odometry` names `map`, as our own topic has it.
            payload = messages.encode_odometry(stamp_ns, np.eye(4), 0.0, 0.0)
            payload = payload.replace(b"\x04\0\0\0map\0", b"\x04\0\0\0odo\0")
            self.decoder.offer(topics.ODOMETRY, payload)
        else:
            rgb, depth = np.zeros((3, 4, 3), np.uint8), np.ones((3, 4), np.uint16)
            self.decoder.offer(topics.RGB, messages.encode_image(stamp_ns, "eye", rgb))
            self.decoder.offer(topics.DEPTH, messages.encode_image(stamp_ns, "eye", depth))
            if self._leads_cloud:
                cloud = messages.encode_point_cloud(stamp_ns, "lidar", np.ones((5, 3), np.float32))
                self.decoder.offer(topics.CLOUD, cloud)

    def _move(self, stamp_ns: int, parent: str, child: str, yaw_rad: float) -> None:
        child = "odo" if child == "odom" else child
        self.frames.take(
            encode_transforms([Transform(stamp_ns, parent, child, se3(yaw_rad=yaw_rad))]),
            static=False,
        )


def errors_rad(observation) -> tuple[float, ...]:
    """Return the angles of camera, LiDAR and base from their former direction."""
    s = (observation.stamp_ns - BEGIN_NS) * 1e-9
    yaws = (se2_of(T).yaw_rad for T in (
        observation.T_base_camera, observation.T_base_lidar, observation.T_map_base
    ))  # fmt: skip
    right = PAN_RADPS * s, PAN_RADPS * s, MAP_RADPS * s
    off = (yaw - turned for yaw, turned in zip(yaws, right, strict=True))
    return tuple(abs((o + np.pi) % (2 * np.pi) - np.pi) for o in off)


@pytest.mark.parametrize(
    ("late_ms", "hz"),
    [
        ({}, {}),
        ({"frames": 900}, {}),
        ({"frames": 60, "odom": 300, "pan": 250, "map": 100}, {}),
        ({"frames": 100}, {"pan": 5, "map": 5, "odom": 10}),
        ({"frames": 40}, {"pan": 500, "map": 500, "odom": 500}),
    ],
)
@pytest.mark.parametrize("data", [ONNX, CLOUD])
def test_mounts_and_map_are_those_of_the_stamp(late_ms, hz, data):
    seen = Head(late_ms, hz, data).live()
    assert len(seen) > 0.8 * min([30, *hz.values()]) * LIFE_MS / 1000
    begun_ns = BEGIN_NS + 300 * MS  # of each frame the first transform alone holds for all time
    for observation in (o for o in seen if o.stamp_ns > begun_ns):
        camera_rad, lidar_rad, base_rad = errors_rad(observation)
        assert camera_rad < 0.002
        assert base_rad < 0.002
        assert lidar_rad < 0.002 or data is ONNX
        assert observation.pose_age_ns == 0


@pytest.mark.parametrize("late", ["pan", "map"])
def test_a_late_transform_falls_back_to_the_newest(late, caplog):
    head = Head({late: 800}, {})
    seen = head.live()[30:]
    assert len(seen) > 20
    for observation in seen:
        age_s = observation.pose_age_ns * 1e-9
        assert 0.25 < age_s < 0.45
        turned_rad = age_s * abs({"pan": PAN_RADPS, "map": MAP_RADPS}[late])
        assert max(errors_rad(observation)[::2]) == pytest.approx(turned_rad, abs=0.05)
    assert head.synchronizer.counters["old_pose"] >= len(seen)
    assert caplog.text.count("tf: mapped with transforms") == 1
