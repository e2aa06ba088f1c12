"""Agreement of depth images with poses, from the simulator's robot in its house."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from simulated import simulated

from edge.geometry import SE2, CameraModel
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checks.depth_motion import MISFIT, MOST_RETRY_NS, RETRY_NS, DepthMotionCheck

SECOND_NS = 1_000_000_000
TICK_NS = SECOND_NS // 10
Drive = Callable[[float], SE2]
CAMERA = {"width_px": 160, "height_px": 128}
STRIDE = 5


@pytest.fixture(scope="module")
def house() -> ClosedLoop:
    return ClosedLoop(simulated({"sensors": {"camera": CAMERA}}), colour=False)


def ahead(t_s: float) -> SE2:
    return SE2(START.x_m + 0.4 * t_s, START.y_m, START.yaw_rad)


def turning(t_s: float) -> SE2:
    return SE2(START.x_m, START.y_m, START.yaw_rad + 0.8 * t_s)


def around(t_s: float) -> SE2:
    return SE2(START.x_m + 0.4 * math.sin(t_s), START.y_m + 0.3 * (1 - math.cos(t_s)), t_s)


START = SE2(1.6, 1.4, 0.7)


class Eye:
    """A camera whose images and poses a test chooses."""

    def __init__(self, house: ClosedLoop) -> None:
        robot = house.config.robot
        self.rig = house.rig
        self.motion = DepthMotionCheck(robot.max_speed_mps, robot.max_turn_radps)
        self.now_ns = 0

    def see(
        self, true: SE2, reported: SE2, change: Callable[[np.ndarray], object] = lambda d: d
    ) -> float:
        """Return the misfit of the image from one pose under another."""
        self.now_ns += TICK_NS
        self.rig.look(true)
        depth_m = self.rig.depth_m.copy()
        change(depth_m)
        sample_m = depth_m[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]
        T = reported.matrix() @ self.rig.T_base_camera
        return self.motion.misfit(
            depth_m, sample_m, (STRIDE, STRIDE), self.rig.model, T, 0.0, self.now_ns, self.now_ns,
            False,
        )  # fmt: skip

    def worst(self, true: Drive, reported: Drive, **options) -> float:
        found = [self.see(true(0.1 * i), reported(0.1 * i), **options) for i in range(20)]
        return max((m for m in found if not math.isnan(m)), default=math.nan)


def test_nothing_seen_proves_nothing(house):
    empty = np.zeros((8, 8), np.float32)
    eye = Eye(house)
    camera = CameraModel.from_hfov(8, 8, 1.0)
    for i in range(20):
        T = SE2(0.05 * i, 0, 0).matrix() @ house.rig.T_base_camera
        found = eye.motion.misfit(empty, empty, (1, 1), camera, T, 0.0, i, i, False)
        assert math.isnan(found)


@pytest.mark.parametrize("drive", [ahead, turning, around])
def test_images_that_match_the_pose_have_a_low_misfit(house, drive):
    assert Eye(house).worst(drive, drive) < 0.5 * MISFIT


@pytest.mark.parametrize(
    ("true", "reported"),
    [
        (ahead, turning),
        (turning, ahead),
        (lambda t_s: ahead(0.0), ahead),
        (turning, lambda t_s: turning(-t_s)),
        (lambda t_s: SE2(*_turned(ahead(t_s), 1.2)), ahead),
    ],
    ids=["turns instead", "drives instead", "stands", "turns the other way", "mounted askew"],
)
def test_images_from_elsewhere_do_not(house, true, reported):
    assert Eye(house).worst(true, reported) > MISFIT


def _turned(pose: SE2, yaw_rad: float) -> tuple[float, float, float]:
    return pose.x_m, pose.y_m, pose.yaw_rad + yaw_rad


@pytest.mark.parametrize("px_per_tick", [-8, 3, 8])
@pytest.mark.parametrize("drive", [ahead, around])
def test_a_passing_person_does_not_contradict_the_pose(house, drive, px_per_tick):
    at_px = [80]

    def walks(depth_m: np.ndarray) -> None:
        left = at_px[0] = (at_px[0] + px_per_tick) % 120
        depth_m[:, left : left + 40] = 1.2

    assert not Eye(house).worst(drive, drive, change=walks) > MISFIT


def test_people_in_front_of_most_strips_do_not_contradict_the_pose(house):
    """Three of eight strips have no depth, four show people, and one shows the house."""
    near_m = [1.2]

    def walk(depth_m: np.ndarray) -> None:
        near_m.append(near_m[-1] + 0.8 if near_m[-1] < 2.0 else 1.2)
        depth_m[:, :60], depth_m[:, 60:140] = 0.0, near_m[-1]

    assert not Eye(house).worst(ahead, ahead, change=walk) > MISFIT


def test_a_first_failure_lasts_less_than_a_second(house):
    eye, ticks = Eye(house), 0
    at = next(0.1 * i for i in range(20) if eye.see(ahead(0.1 * i), turning(0.1 * i)) > MISFIT)
    while eye.see(ahead(at), ahead(at)) > MISFIT:
        ticks += 1
    assert ticks * TICK_NS < SECOND_NS


def test_a_corrected_pose_is_not_motion(house):
    eye = Eye(house)
    assert eye.worst(ahead, ahead) < MISFIT
    moved = [
        SE2(p.x_m + 0.3, p.y_m + 0.2, p.yaw_rad) for p in (ahead(2.0 + 0.1 * i) for i in range(9))
    ]
    found = [eye.see(ahead(2.0 + 0.1 * i), pose) for i, pose in enumerate(moved)]
    assert not any(m > MISFIT for m in found)


def test_a_standing_robot_retries_at_growing_intervals(house):
    eye, waits = Eye(house), []
    for _ in range(5):
        assert eye.worst(ahead, turning) > MISFIT
        begin_ns = eye.now_ns
        while eye.see(ahead(0), ahead(0)) > MISFIT:
            eye.now_ns += SECOND_NS
        waits.append(eye.now_ns - begin_ns)
    expected = [min(2**k * RETRY_NS, MOST_RETRY_NS) for k in range(5)]
    assert waits == pytest.approx(expected, abs=3 * SECOND_NS)
    assert eye.worst(around, around) < MISFIT
    assert eye.worst(around, around) < MISFIT
    assert eye.worst(ahead, turning) > MISFIT
    begin_ns = eye.now_ns
    while eye.see(ahead(0), ahead(0)) > MISFIT:
        eye.now_ns += SECOND_NS
    assert eye.now_ns - begin_ns == pytest.approx(RETRY_NS, abs=3 * SECOND_NS), "it fitted again"
