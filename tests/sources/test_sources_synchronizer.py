"""Messages become observations, or counted drops."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from edge.bus import topics
from edge.bus.wire import messages
from edge.config import ConfigError
from edge.geometry import SE2, CameraModel, Lens
from edge.sources import messages as typed
from edge.sources.decoder import CdrDecoder
from edge.sources.synchronizer import TimeSynchronizer

MS = 1_000_000
WAIT_NS = 500 * MS  # source.wait_s
FRAME_NS = 33_333_333
CAMERA = CameraModel(4, 3, 5.0, 5.0, 1.5, 1.0)
ONNX = {"perception": {"detector": {"kind": "onnx"}}}
CLOUD = {
    "mapping": {"input": "cloud"},
    "perception": {"detector": {"kind": "onnx"}, "back_projection": "cloud"},
    "sensors": {"lidar": {"x_m": 0.2, "z_m": 0.4, "pitch_deg": 23.0}},
}


class Robot:
    """Feeds a synchronizer on a clock that only the test moves."""

    def __init__(self, data: dict = ONNX) -> None:
        self.now_ns = 0
        self.synchronizer = TimeSynchronizer(simulated(data), clock=lambda: self.now_ns)
        self.decoder = CdrDecoder(self.synchronizer, clock=lambda: self.now_ns)

    def send(self, topic, payload: bytes) -> Robot:
        self.decoder.offer(topic, payload)
        return self

    def info(self, camera=CAMERA) -> Robot:
        return self.send(topics.CAMERA_INFO, messages.encode_camera_info(1, "camera", camera))

    def odom(self, stamp_ns: int, x_m: float = 0.0) -> Robot:
        payload = messages.encode_odometry(stamp_ns, SE2(x_m, 0.0, 0.0).matrix(), 0.0, 0.0)
        return self.send(topics.ODOMETRY, payload)

    def rgb(self, stamp_ns: int, value: int = 1, shape=(3, 4, 3)) -> Robot:
        image = np.full(shape, value, np.uint8)
        return self.send(topics.RGB, messages.encode_image(stamp_ns, "camera", image))

    def depth(self, stamp_ns: int, mm: int = 1500, shape=(3, 4)) -> Robot:
        image = np.full(shape, mm, np.uint16)
        return self.send(topics.DEPTH, messages.encode_image(stamp_ns, "camera", image))

    def cloud(self, stamp_ns: int, n: int = 5) -> Robot:
        points = np.arange(3 * n, dtype=np.float32).reshape(n, 3)
        return self.send(topics.CLOUD, messages.encode_point_cloud(stamp_ns, "lidar", points))

    def frame(self, stamp_ns: int, value: int = 1) -> Robot:
        return self.rgb(stamp_ns, value).depth(stamp_ns)

    def poll(self):
        return self.synchronizer.poll()

    def wait(self, ns: int = WAIT_NS + 1) -> Robot:
        self.now_ns += ns
        return self

    @property
    def drops(self) -> dict[str, int]:
        drops = {k: n for k, n in self.synchronizer.counters.items() if n}
        drops.pop("received", None)
        drops.pop("observations", None)
        return drops


def test_nothing_gives_nothing():
    robot = Robot()
    assert robot.poll() is None
    assert not robot.drops


REAR = CameraModel(6, 2, 3.0, 3.0, 2.5, 0.5)
PAIR = {**ONNX, "sensors": {"second_camera": {"yaw_deg": 180.0, "rate_hz": 10.0}}}


class Pair(Robot):
    """A robot with a second camera, of another size."""

    def __init__(self, **sections: dict) -> None:
        super().__init__({**PAIR, **sections})
        self.info().info2()

    def info2(self) -> Robot:
        return self.send(topics.CAMERA_INFO2, messages.encode_camera_info(1, "back", REAR))

    def frame2(self, stamp_ns: int, value: int = 2) -> Robot:
        rgb, mm = np.full((2, 6, 3), value, np.uint8), np.full((2, 6), 2500, np.uint16)
        self.send(topics.RGB2, messages.encode_image(stamp_ns, "back", rgb))
        return self.send(topics.DEPTH2, messages.encode_image(stamp_ns, "back", mm))


def test_messages_of_a_camera_that_is_not_configured_are_ignored():
    robot = Robot().odom(0).odom(9 * FRAME_NS)
    Pair.info2(robot)
    Pair.frame2(robot, FRAME_NS)
    assert robot.poll() is None
    assert not robot.drops


def test_each_camera_has_its_own_intrinsics_and_mount():
    robot = Pair().odom(0).odom(9 * FRAME_NS).frame(FRAME_NS).frame2(2 * FRAME_NS)
    first, second = robot.poll(), robot.poll()
    assert [(o.seq, o.camera_index, o.camera) for o in (first, second)] == [
        (0, 0, CAMERA), (1, 1, REAR),
    ]  # fmt: skip
    assert (first.rgb.shape, second.rgb.shape) == ((3, 4, 3), (2, 6, 3))
    assert (first.rgb == 1).all()
    assert (second.rgb == 2).all()
    np.testing.assert_allclose(second.depth_m, 2.5)
    # The optical axis is the third column.
    assert first.T_base_camera[0, 2] > 0.9
    assert second.T_base_camera[0, 2] < -0.9
    assert robot.poll() is None
    assert not robot.drops


@pytest.mark.parametrize("apart_ns", [0, FRAME_NS // 3, -3 * FRAME_NS])
def test_cameras_take_turns_also_if_one_is_late(apart_ns):
    robot = Pair().odom(0)
    seen = []
    for k in range(1, 21):
        stamp_ns = (k + 3) * FRAME_NS
        robot.frame(stamp_ns).frame2(stamp_ns + apart_ns).odom(stamp_ns + FRAME_NS)
        seen.append(robot.poll())
        seen[-1].release()
    assert [o.camera_index for o in seen] == [0, 1] * 10
    for camera in (seen[::2], seen[1::2]):
        assert all(np.diff([o.stamp_ns for o in camera]) == 2 * FRAME_NS)


def test_one_camera_continues_alone_and_after_a_clock_reset():
    robot = Pair().odom(0).odom(FRAME_NS * 9)
    for k in (1, 2, 3):
        assert robot.frame2(k * FRAME_NS).poll().camera_index == 1
    for k in range(20):  # the sensors' clock is set back
        robot.odom(k).frame2(k)
    assert robot.poll().stamp_ns < 20
    states = {row.name: (row.state, row.needed) for row in robot.synchronizer.inputs.rows()}
    assert states["camera/rgb"] == states["camera/depth"] == ("missing", True)
    assert states["camera2/rgb"] == states["camera2/info"] == ("ok", True)


@pytest.mark.parametrize("silent", [None, 0, 1], ids=["", "no camera", "no camera2"])
def test_each_cloud_goes_to_one_camera_in_turn(silent):
    """Images of the second camera come later than those of the first."""
    robot = Pair(**{**CLOUD, "sensors": {**CLOUD["sensors"], **PAIR["sensors"]}}).odom(0)
    seen = []
    for k in range(1, 11):
        stamp_ns = k * 100 * MS
        robot.odom(stamp_ns + MS).cloud(stamp_ns)
        for send in (robot.rgb, robot.frame2):
            if silent is None or send != (robot.rgb, robot.frame2)[silent]:
                send(stamp_ns)
            if (observation := robot.wait(30 * MS).poll()) is not None:
                seen.append(observation)
                observation.release()
        robot.wait(40 * MS)
    assert [o.camera_index for o in seen] == [0, 1] * 5
    assert [o.stamp_ns // (100 * MS) for o in seen] == list(range(1, 11))
    assert all(len(o.cloud_m) == 5 for o in seen)
    assert {o.camera_index for o in seen if o.rgb is None} == {silent} - {None}
    assert not robot.drops


def test_a_frame_with_its_interpolated_pose():
    robot = Robot().info().odom(1000, 0.0).frame(1500).odom(2000, 0.5)
    observation = robot.poll()
    assert (observation.seq, observation.stamp_ns) == (0, 1500)
    assert observation.pose.x_m == pytest.approx(0.25)
    assert observation.camera == CAMERA
    assert (observation.rgb == 1).all()
    np.testing.assert_allclose(observation.depth_m, 1.5)
    assert observation.cloud_m is None
    assert observation.T_base_camera[2, 3] == pytest.approx(0.6)
    assert robot.poll() is None
    assert robot.synchronizer.counters["observations"] == 1
    assert robot.synchronizer.counters["received"] == 5
    assert not robot.drops


@pytest.mark.parametrize(
    ("settings", "farthest_m"),
    [
        ({}, 8.0),
        ({"sensors": {"camera": {"depth_max_m": 20.0}}}, 20.0),
        ({"mapping": {"range_m": 12.0}}, 12.0),
        ({"perception": {"detector": {"kind": "onnx"}, "back_projection_max_range_m": 15.0}}, 15.0),
    ],
)
def test_depth_beyond_the_camera_range_is_no_return(settings, farthest_m):
    near = [0.3, 2.0, 0.99 * farthest_m]
    beyond = [farthest_m, 1.01 * farthest_m, 65.535, 1e6, np.inf]
    depth = np.array([[*near, *beyond, np.nan, -1.0, 0.0, 0.0]], np.float32).reshape(3, 4)
    robot = Robot({**ONNX, **settings}).info().odom(0).odom(2000).rgb(1000)
    robot.send(topics.DEPTH, messages.encode_image(1000, "camera", depth))
    seen = robot.poll().depth_m
    assert seen.ravel()[:8].tolist() == [*np.float32(near), 0, 0, 0, 0, 0]
    np.testing.assert_array_equal(seen[2], depth[2])


LATE = [
    *(("odom", ms, hz) for ms in (0, 60, 130, 300, 450) for hz in (60, 20)),
    ("odom", 0, 5), ("odom", 150, 5),
    ("camera/rgb", 200, 60), ("camera/rgb", 450, 60),
    ("camera/depth", 200, 60), ("camera/depth", 900, 60),
    ("frames", 200, 60), ("frames", 900, 250),
]  # fmt: skip


@pytest.mark.parametrize(("late", "late_ms", "odometry_hz"), LATE)
def test_late_messages_are_joined_at_their_stamp(late, late_ms, odometry_hz):
    """A robot at 1 m/s for 4 s, with frames at 30 Hz."""
    robot, begin_ns, late_ns = Robot().info(), 10**12, late_ms * MS
    arrivals = []
    for k in range(120):
        stamp_ns = k * FRAME_NS
        for name, send in (("camera/rgb", robot.rgb), ("camera/depth", robot.depth)):
            arrivals.append((stamp_ns + late_ns * (late in (name, "frames")), 1, send, stamp_ns))
    for k in range(5 * odometry_hz):
        stamp_ns = k * 10**9 // odometry_hz
        arrivals.append((stamp_ns + late_ns * (late == "odom"), 0, robot.odom, stamp_ns))
    seen = []
    for at_ns, _, send, stamp_ns in sorted(arrivals, key=lambda arrival: arrival[:2]):
        robot.now_ns = at_ns
        send(begin_ns + stamp_ns, *([1e-9 * stamp_ns] if send == robot.odom else []))
        if (observation := robot.poll()) is not None:
            observation.release()
            seen.append(observation)
            assert observation.pose.x_m == pytest.approx(1e-9 * (observation.stamp_ns - begin_ns))
            assert observation.pose_age_ns == 0
            took_ms = (robot.now_ns + begin_ns - observation.stamp_ns) / MS
            assert took_ms <= late_ms + 1e3 / odometry_hz + 1
    # One pose may free several frames, of which the newest wins.
    assert len(seen) > 3.3 * min(odometry_hz, 30)
    assert not robot.drops.keys() - {"superseded"}


@pytest.mark.parametrize(("without", "ms"), [("", 0), ("rgb", 51), ("late rgb", 251)])
def test_a_sweep_waits_for_an_image_within_a_limit(without, ms):
    robot = Robot(CLOUD).info()
    if without == "late rgb":
        robot.wait(300 * MS).cloud(300 * MS).wait(200 * MS).rgb(300 * MS).poll()
    begin_ns = robot.now_ns = 1000 * MS
    robot.odom(900 * MS).odom(1100 * MS).cloud(1000 * MS)
    if not without:
        robot.rgb(1000 * MS)
    while (seen := robot.poll()) is None:
        robot.wait(MS)
    assert robot.now_ns - begin_ns == ms * MS
    assert (seen.rgb is None) == bool(without)


def test_frames_that_wait_take_no_more_than_their_room():
    limits = {"source": {"max_message_mb": 0.001, "odometry_ring": 64}}
    robot = Robot({**ONNX, **limits}).info().odom(0)
    for k in range(500):
        robot.wait(MS).depth(k * MS, shape=(10, 10)).rgb(k * MS, shape=(10, 10, 3)).odom(0)
    for stream in robot.synchronizer.streams.values():
        assert 4 <= len(stream.newest_first()) <= 64
        assert sum(frame.size for frame in stream.newest_first()) <= 4000


@pytest.mark.parametrize(
    ("odometry_ns", "stamp_ns", "reason"),
    [
        ([], 1500, "no_pose"),
        ([1000], 1000 + 10**9, "no_pose"),
        ([1000, 10**9], 5000, "no_pose"),
        ([1000], 500, "stale"),
    ],
)
def test_a_frame_without_a_pose_is_dropped(odometry_ns, stamp_ns, reason):
    robot = Robot().info()
    for at_ns in odometry_ns:
        robot.odom(at_ns)
    robot.frame(stamp_ns).wait()
    assert robot.poll() is None
    assert robot.drops == {reason: 1}


def test_lockstep_waits_without_a_limit():
    robot = Robot({**ONNX, "loop": {"lockstep": True}}).info().odom(1000).frame(1500)
    assert robot.wait(10**12).poll() is None
    assert robot.odom(1500, 0.5).poll().pose.x_m == 0.5


def test_a_waiting_frame_does_not_delay_a_complete_one():
    robot = Robot().info().odom(1000).odom(2 * FRAME_NS)
    robot.frame(FRAME_NS, value=1).frame(3 * FRAME_NS, value=3)
    assert robot.poll().stamp_ns == FRAME_NS
    assert robot.poll() is None
    assert robot.odom(4 * FRAME_NS).poll().stamp_ns == 3 * FRAME_NS


def test_no_camera_info():
    robot = Robot().odom(0).odom(2000).frame(1000)
    assert robot.poll() is None
    assert robot.drops == {"no_camera_info": 1}
    assert robot.info().odom(FRAME_NS * 2).frame(FRAME_NS).poll() is not None


@pytest.mark.parametrize(
    ("rgb_shape", "depth_shape", "reason"),
    [
        ((3, 4, 3), (3, 5), "wrong_size"),
        ((6, 8, 3), (3, 4), "wrong_size"),
        ((0, 4, 3), (3, 4), "empty"),
        ((3, 4, 3), (0, 0), "empty"),
    ],
)
def test_images_of_the_wrong_size(rgb_shape, depth_shape, reason):
    robot = Robot().info().odom(0).odom(2000)
    robot.rgb(1000, shape=rgb_shape).depth(1000, shape=depth_shape)
    assert robot.poll() is None
    assert robot.drops == {reason: 1}
    assert robot.odom(FRAME_NS * 2).frame(FRAME_NS).poll() is not None


@pytest.mark.parametrize("topic", [topics.RGB, topics.DEPTH, topics.ODOMETRY, topics.CAMERA_INFO])
@pytest.mark.parametrize(
    ("payload", "reason"),
    [(b"", "empty"), (b"junk", "malformed"), (b"\0\1\0\0" + b"\xff" * 40, "malformed")],
)
def test_junk_is_counted_and_the_next_frame_is_taken(topic, payload, reason):
    robot = Robot({}).info().odom(0)
    robot.send(topic, payload)
    assert robot.poll() is None
    assert robot.drops == {reason: 1}
    assert robot.odom(FRAME_NS * 2).frame(FRAME_NS).poll() is not None


def test_pixels_that_are_cut_off_are_counted():
    robot = Robot().info().odom(0).odom(2000).rgb(1000)
    payload = messages.encode_image(1000, "camera", np.ones((3, 4), np.uint16))
    assert robot.send(topics.DEPTH, payload[:-1]).poll() is None
    assert robot.drops == {"malformed": 1}


def test_repeated_and_backward_frames():
    robot = Robot().info().odom(0).odom(10 * FRAME_NS // 10)
    assert robot.frame(2000).poll() is not None
    robot.frame(2000).frame(1000)
    assert robot.poll() is None
    assert robot.drops == {"repeated": 2, "backward": 2}


def test_an_exhausted_pool_is_counted_and_recovers():
    robot = Robot({**ONNX, "source": {"pool_slots": 3}}).info().odom(0)
    held = []
    for k in range(1, 5):
        robot.odom(k * FRAME_NS).frame(k * FRAME_NS, value=k)
        held.append(robot.poll())
    assert held[3] is None
    assert robot.drops == {"pool_exhausted": 1}
    held[0].release()
    fifth = robot.odom(5 * FRAME_NS).frame(5 * FRAME_NS, value=5).poll()
    assert fifth.rgb is held[0].rgb
    assert (held[1].rgb == 2).all()


def test_a_pose_jump_raises_the_epoch():
    robot = Robot().info().odom(1000, 0.0).odom(2000, 50.0)
    assert robot.drops == {"pose_jump": 1}
    assert not any(row.dropped for row in robot.synchronizer.inputs.rows())
    assert robot.synchronizer.odometry.epoch == 1
    assert robot.frame(1500).wait().poll() is None
    assert robot.drops == {"pose_jump": 1, "stale": 1}


def test_another_camera_brings_another_pool():
    robot = Robot().info().odom(0).odom(1000).frame(1000)
    first = robot.poll()
    robot.info(CameraModel(8, 6, 5.0, 5.0, 3.5, 2.5)).odom(FRAME_NS)
    robot.rgb(FRAME_NS, 7, (6, 8, 3)).depth(FRAME_NS, shape=(6, 8))
    assert robot.poll().rgb.shape == (6, 8, 3)
    assert (first.rgb == 1).all()
    first.release()


LENS = Lens("plumb_bob", (-0.3, 0.1, 0.0, 0.0), CameraModel(40, 30, 30.0, 30.0, 20.0, 15.0))
STRAIGHT = CameraModel(40, 30, 24.0, 24.0, 19.5, 14.5)
RECT, RAW = "/front/image_rect", "/front/image_raw"
STEPS_MM = np.broadcast_to(1000 + 100 * np.arange(40, dtype=np.uint16), (30, 40))
STRIPES = np.dstack([STEPS_MM // 20] * 3).astype(np.uint8)


def through_a_lens(settings: dict, lens: Lens = LENS, rgb: str = RAW, depth: str = RAW) -> Robot:
    """Return a robot that has sent one image and depth of vertical stripes."""
    robot = Robot({**ONNX, "source": settings}).odom(0).odom(FRAME_NS)
    robot.synchronizer.inputs.listen("camera/rgb", rgb)
    robot.synchronizer.inputs.listen("camera/depth", depth)
    robot.synchronizer.received("camera/info")
    robot.synchronizer.offer(typed.CameraInfo(STRAIGHT, lens))
    robot.send(topics.RGB, messages.encode_image(1000, "camera", STRIPES))
    return robot.send(topics.DEPTH, messages.encode_image(1000, "camera", STEPS_MM))


@pytest.mark.parametrize(
    ("distortion", "rgb", "depth", "made", "straight", "says"),
    [
        ("rectify", RAW, RAW, "rectified", (True, True), "images and depth are rectified"),
        ("rectify", RAW, RECT, "rectified", (True, False), "images are rectified; if"),
        (
            "rectify",
            RECT,
            RAW,
            "ignored",
            (False, False),
            f"images are used as rectified: {RECT} has rect in its name",
        ),
        (
            "ignore",
            RAW,
            RAW,
            "ignored",
            (False, False),
            "images are used as rectified: source.distortion is ignore",
        ),
    ],
)
def test_images_of_a_distorting_lens_are_rectified(
    caplog, distortion, rgb, depth, made, straight, says
):
    caplog.set_level("INFO")
    robot = through_a_lens({"distortion": distortion}, rgb=rgb, depth=depth)
    seen = robot.poll()
    assert (seen.distortion, seen.camera) == (made, STRAIGHT)
    as_sent = [(seen.rgb == STRIPES).all(), (seen.depth_m == STEPS_MM * np.float32(0.001)).all()]
    assert as_sent == [not bent for bent in straight]
    (line,) = caplog.messages
    assert re.match(f"camera/info: plumb_bob distortion, k1 = -0.3: {says}", line)


@pytest.mark.parametrize(
    ("distortion", "lens", "says"),
    [
        ("refuse", LENS, "k1 = -0.3: source.distortion is refuse"),
        ("rectify", replace(LENS, model="odd"), "known: plumb_bob, .*distortion: ignore"),
    ],
)
def test_a_lens_that_is_refused_leaves_no_images(caplog, distortion, lens, says):
    robot = through_a_lens({"distortion": distortion}, lens)
    assert robot.poll() is None
    assert robot.drops == {"distorted": 1, "no_camera_info": 1}
    (row,) = (row for row in robot.synchronizer.inputs.rows() if row.name == "camera/info")
    assert row.state == "dropped"
    assert re.search(says, row.why)
    robot.info().odom(2 * FRAME_NS).frame(2 * FRAME_NS)
    assert robot.poll().distortion == "none"


def test_a_cloud_alone_is_an_observation():
    robot = Robot(CLOUD).odom(0).odom(2000).cloud(1000)
    assert robot.poll() is None
    observation = robot.wait().poll()
    np.testing.assert_array_equal(observation.cloud_m, np.arange(15).reshape(5, 3))
    assert observation.rgb is None
    assert observation.camera is None
    assert observation.T_base_lidar[:3, 3].tolist() == [0.2, 0.0, 0.4]
    assert observation.T_base_lidar[2, 0] == pytest.approx(-np.sin(np.radians(23.0)))


def test_a_bad_image_does_not_cost_the_cloud():
    robot = Robot(CLOUD).info().odom(0).odom(2000).rgb(1000, shape=(5, 5, 3)).cloud(1000)
    observation = robot.poll()
    assert len(observation.cloud_m) == 5
    assert observation.rgb is None
    assert robot.drops == {"wrong_size": 1}


def test_a_scan_is_a_cloud_too():
    ranges = np.array([1.0, 2.0], np.float32)
    scan = messages.encode_laser_scan(1000, "lidar", 0.0, np.pi / 2, 10.0, ranges)
    robot = Robot(CLOUD).odom(0).odom(2000).send(topics.SCAN, scan).wait()
    np.testing.assert_allclose(robot.poll().cloud_m, [[1, 0, 0], [0, 2, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("scan_inf", "value", "rows"),
    [
        ("free", np.inf, [[10.0, 0.0, np.inf]]),
        ("ignore", np.inf, None),
        ("free", np.nan, None),
        ("free", -np.inf, None),
    ],
)
def test_infinite_ranges_count_as_free_if_configured(caplog, scan_inf, value, rows):
    scan = messages.encode_laser_scan(1000, "l", 0.0, 0.0, 10.0, np.full(1, value, np.float32))
    robot = Robot({**CLOUD, "source": {"scan_inf": scan_inf}}).odom(0).odom(2000)
    seen = robot.send(topics.SCAN, scan).wait().poll()
    assert (None if seen is None else seen.cloud_m.tolist()) == rows
    assert robot.drops == ({"empty": 1} if rows is None else {})
    assert ("no beam has a valid range" in caplog.text) == (rows is None)


def test_an_empty_cloud_and_one_too_large():
    robot = Robot({**CLOUD, "source": {"max_cloud_points": 16}}).odom(0).odom(FRAME_NS)
    robot.cloud(1000, n=0).cloud(2000, n=17).wait()
    assert robot.poll() is None
    assert robot.drops == {"empty": 1, "malformed": 1}


SCAN = messages.encode_laser_scan(2000, "lidar", 0.0, 0.1, 10.0, np.ones(17, np.float32))
WIDE = CameraModel(100, 80, 90.0, 90.0, 50.0, 40.0)


@pytest.mark.parametrize(
    ("key", "limit", "send"),
    [
        ("max_cloud_points", 16, lambda robot: robot.cloud(2000, n=17)),
        ("max_cloud_points", 16, lambda robot: robot.send(topics.SCAN, SCAN)),
        ("max_message_mb", 0.02, lambda robot: robot.info(WIDE)),
        ("max_pose_jump_m", 1.0, lambda robot: robot.odom(2 * FRAME_NS, x_m=50.0)),
        ("pool_slots", 3, lambda robot: [robot.cloud(k).wait().poll() for k in range(2, 6)]),
    ],
)
def test_a_drop_by_a_limit_names_its_setting(caplog, key, limit, send):
    robot = Robot({**CLOUD, "source": {key: limit}}).odom(0).odom(FRAME_NS).cloud(1)
    robot.wait().poll()
    assert not caplog.messages
    send(robot)
    robot.wait().poll()
    assert f"source.{key}" in caplog.text


def test_cloud_without_a_lidar_is_a_configuration_error():
    with pytest.raises(ConfigError, match=r"mapping\.input: cloud needs sensors\.lidar"):
        TimeSynchronizer(simulated({"mapping": {"input": "cloud"}}))


def test_a_frame_that_breaks_its_decoder_is_dropped(monkeypatch):
    robot = Robot({**ONNX, "source": {"pool_slots": 3}}).info()

    def broken(*_) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(messages, "decode_image_into", broken)
        for k in range(1, 5):
            robot.odom(k * FRAME_NS).frame(k * FRAME_NS)
            with pytest.raises(ZeroDivisionError):
                robot.poll()
    assert robot.poll() is None
    assert robot.odom(5 * FRAME_NS).frame(5 * FRAME_NS).poll().stamp_ns == 5 * FRAME_NS
    assert not robot.drops


def test_typed_messages_are_opened_only_when_used():
    """As a source on another transport hands them in."""
    opened = []

    def frame(kind, stamp_ns: int, value: float):
        def into(out: np.ndarray) -> int:
            opened.append((kind.field, stamp_ns))
            out[:] = value
            return len(out)

        return kind(stamp_ns, 0, into)

    synchronizer = Robot().synchronizer
    synchronizer.offer(typed.CameraInfo(CAMERA))
    for stamp_ns in (0, FRAME_NS, 2 * FRAME_NS, 3 * FRAME_NS):
        synchronizer.offer(typed.Odometry(stamp_ns, SE2(1e-9 * stamp_ns, 0.0, 0.0).matrix()))
        synchronizer.offer(frame(typed.DepthImage, stamp_ns, 2.5))
        synchronizer.offer(frame(typed.Image, stamp_ns, 9))
        synchronizer.offer(frame(typed.Cloud, stamp_ns, 0.0))  # not configured
    observation = synchronizer.poll()
    assert observation.pose.x_m == pytest.approx(3e-9 * FRAME_NS)
    assert (observation.depth_m == 2.5).all()
    assert (observation.rgb == 9).all()
    assert opened == [("depth_m", 3 * FRAME_NS), ("rgb", 3 * FRAME_NS)]
