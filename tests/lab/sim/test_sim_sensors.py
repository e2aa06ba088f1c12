"""The simulated sensors' messages, and when pictures are taken."""

from __future__ import annotations

import json
import math
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

from edge.bus import topics
from edge.bus.wire import messages
from edge.geometry import SE2
from edge.lab.sim.base import WorldError
from edge.lab.sim.process import _sense, next_frame
from edge.lab.sim.robot import DriveTrain
from edge.lab.sim.sensors import CameraRig, LidarRig, make_rigs, odometry_message, truth_message
from edge.lab.sim.worlds import load_world

POSE = SE2(3.0, 2.0, 0.3)


def config(rings: int = 4, **sim: float):
    camera = {"width_px": 64, "height_px": 48}
    lidar = {"rings": rings, "columns": 120, "noise_m": 0.0}
    return simulated({"sensors": {"camera": camera, "lidar": lidar}, "sim": sim})


@pytest.fixture(scope="module")
def world():
    return load_world(config())


def test_depth_is_sent_in_millimetres_and_read_in_metres(world):
    rig = CameraRig(config(), world)
    rig.look(POSE)
    rig.depth_m[0, 0] = np.nan
    sent = dict(rig.messages(5))
    order = [topics.DEPTH, topics.SEGMENTATION, topics.RGB]
    assert list(sent) == order, "colour completes the frame"
    payload = sent[topics.DEPTH]
    back = np.empty((48, 64), np.float32)
    messages.decode_image_into(payload, messages.decode_image_header(payload), back)
    assert not back[0, 0] > 0.0
    known = np.isfinite(rig.depth_m)
    np.testing.assert_allclose(back[known], rig.depth_m[known], atol=0.0011)


def test_a_turned_sensor_agrees_with_a_turned_robot(world):
    """A sensor turned on the robot sees the same as one ahead on a turned robot."""
    turned = {"x_m": 0.0, "y_m": 0.0, "z_m": 0.6, "yaw_deg": 40.0}
    ahead = {**turned, "yaw_deg": 0.0}
    seen = []
    for mount, pose in ((turned, POSE), (ahead, replace(POSE, yaw_rad=POSE.yaw_rad + 0.6981317))):
        sensors = {
            "camera": {"width_px": 64, "height_px": 48, "pitch_deg": 10.0, **mount},
            "lidar": {"rings": 4, "columns": 120, "noise_m": 0.0, "roll_deg": 5.0, **mount},
        }
        camera, lidar = (
            rig(simulated({"sensors": sensors}), world) for rig in (CameraRig, LidarRig)
        )
        camera.look(pose)
        lidar.look(pose)
        seen.append((camera.depth_m, lidar.ranges_m))
    for one, other in zip(*seen, strict=True):
        close = np.isclose(one, other, rtol=1e-4, equal_nan=True)
        assert close.mean() > 0.98  # but for edges, which a rounding moves by a pixel


def test_depth_noise_grows_with_the_square_of_the_distance(world):
    clean, noisy = CameraRig(config(), world), CameraRig(config(depth_noise=0.01), world)
    clean.look(POSE)
    noisy.look(POSE)
    error = (noisy.depth_m - clean.depth_m) / clean.depth_m**2
    assert np.nanstd(error) == pytest.approx(0.01, rel=0.1)
    again = CameraRig(config(depth_noise=0.01), world)
    again.look(POSE)
    np.testing.assert_array_equal(again.depth_m, noisy.depth_m)


def test_several_rings_make_a_cloud_of_the_returns(world):
    rig = LidarRig(config(rings=4), world)
    rig.look(POSE)
    [(topic, _)] = rig.messages(5)
    assert topic is topics.CLOUD
    cloud = rig.cloud_m()
    assert len(cloud) == np.isfinite(rig.ranges_m).sum() > 100
    ranges = np.sort(np.linalg.norm(cloud, axis=1))
    np.testing.assert_allclose(ranges, np.sort(rig.ranges_m[np.isfinite(rig.ranges_m)]), rtol=1e-5)


def test_one_ring_gives_a_scan_that_starts_behind_the_robot(world):
    rig = LidarRig(config(rings=1), world)
    rig.look(POSE)
    [(topic, payload)] = rig.messages(5)
    assert topic is topics.SCAN
    scan = messages.decode_laser_scan(payload)
    assert scan.angle_min_rad == pytest.approx(-math.pi)
    np.testing.assert_allclose(scan.ranges_m, rig.ranges_m[0], rtol=1e-6)


def test_odometry_and_truth_are_of_the_same_instant(world):
    settings = config(drift_m_per_m=0.2)
    body = DriveTrain(settings.robot, settings.sim, world, POSE, stamp_ns=1000)
    motion = body.step(1.0, 0.3, 0.0)
    topic, payload = odometry_message(motion)
    odometry = messages.decode_odometry(payload)
    assert (topic, odometry.stamp_ns) == (topics.ODOMETRY, 1000 + 10**9)
    topic, payload = truth_message(motion)
    truth = json.loads(payload)
    assert (topic, truth["stamp_ns"]) == (topics.GROUND_TRUTH, odometry.stamp_ns)
    assert truth["pose"] == [motion.pose.x_m, motion.pose.y_m, motion.pose.yaw_rad]
    assert abs(odometry.T_map_base[0, 3] - truth["pose"][0]) > 1e-3, "it drifted"


@pytest.mark.parametrize(
    ("now_s", "expected_s"),
    [(10.0, 10.1), (10.05, 10.1), (9.0, 10.1), (10.15, 10.2), (10.95, 11.0)],
)
def test_late_pictures_are_left_out(now_s: float, expected_s: float):
    assert next_frame(10.0, 0.1, now_s) == pytest.approx(expected_s)


def test_a_sensor_sends_each_stamp_once_if_the_robot_is_late():
    sent, stop = [], threading.Event()
    rig = SimpleNamespace(rate_hz=1e6, look=lambda pose: None, description=lambda stamp_ns: [],
                          messages=lambda stamp_ns: [stamp_ns])  # fmt: skip
    drive = SimpleNamespace(motion=SimpleNamespace(stamp_ns=0, pose=POSE))

    def move() -> None:
        for stamp_ns in range(1, 6):
            time.sleep(0.01)
            drive.motion = SimpleNamespace(stamp_ns=stamp_ns, pose=POSE)
        time.sleep(0.01)
        stop.set()

    mover = threading.Thread(target=move)
    mover.start()
    _sense(rig, drive, SimpleNamespace(send=sent.extend), stop)
    mover.join()
    assert len(sent) > 1
    assert sent == sorted(set(sent))


@pytest.mark.parametrize("sensor", ["camera", "lidar"])
def test_a_simulated_sensor_is_over_the_floor(world, sensor):
    """A real base frame may be above its sensor; the simulated one is on the floor."""
    sensors = {"lidar": {}, sensor: {"z_m": -0.05}}
    with pytest.raises(
        WorldError, match=f"^f.yaml: sensors.{sensor}.z_m: got -0.05 m, .* above 0$"
    ):
        make_rigs(simulated({"sensors": sensors}, "f.yaml"), world)
