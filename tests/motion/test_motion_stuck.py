"""Standing still, getting nowhere, getting free."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import Robot
from edge.geometry import SE2, Grid
from edge.motion.progress import DETOURS, Progress
from edge.motion.pursuit import MotionLimits
from edge.motion.recovery import BACK_M, TIME_NS, Recovery
from edge.motion.stuck import StuckDetector
from edge.trajectory.costmap import from_weights

S = 1_000_000_000
HERE = SE2(1.0, 2.0, 0.0)


def run(detector, poses, moving=True, step_ns=S // 10):
    return [detector.update(p, moving, k * step_ns) for k, p in enumerate(poses)]


def test_standing_still_is_stuck_once_in_every_wait():
    said = run(StuckDetector(2.0, 0.05), [HERE] * 45)
    assert [k for k, stuck in enumerate(said) if stuck] == [20, 40]


def test_not_told_to_move_is_not_stuck():
    assert not any(run(StuckDetector(2.0, 0.05), [HERE] * 45, moving=False))


@pytest.mark.parametrize(
    ("step_m", "step_rad", "stuck"),
    [
        (0.0, 0.0, True),
        (0.01, 0.0, False),
        (0.001, 0.0, True),
        (0.0, 0.05, False),
        (0.0, 0.005, True),
    ],
)
def test_slow_motion(step_m, step_rad, stuck):
    poses = [SE2(k * step_m, 0.0, k * step_rad) for k in range(40)]
    assert any(run(StuckDetector(2.0, 0.05), poses)) == stuck


def test_jitter_about_a_point_is_stuck():
    poses = [SE2(0.01 * (-1) ** k, 0.0, 0.02 * (-1) ** k) for k in range(25)]
    assert any(run(StuckDetector(2.0, 0.05), poses))


@pytest.mark.parametrize("pause_s", [0.0, 0.1, 5.0])
def test_a_pause_neither_counts_nor_starts_the_wait_afresh(pause_s):
    detector, paused = StuckDetector(2.0, 0.05), int(10 * pause_s)
    told = [True] * 16 + [False] * paused + [True] * 30
    said = [detector.update(HERE, moving, k * S // 10) for k, moving in enumerate(told)]
    assert [k for k, stuck in enumerate(said) if stuck] == [20 + paused, 40 + paused]


def test_a_robot_that_moved_in_a_pause_is_not_stuck():
    detector = StuckDetector(2.0, 0.05)
    assert not any(run(detector, [HERE] * 16))
    assert not detector.update(SE2(1.1, 2.0, 0.0), False, 16 * S // 10)
    assert not any(detector.update(HERE, True, (17 + k) * S // 10) for k in range(20))


def test_time_going_back_is_not_stuck():
    detector = StuckDetector(2.0, 0.05)
    assert not detector.update(HERE, True, 100 * S)
    assert not detector.update(HERE, True, 1 * S)
    assert not detector.update(HERE, True, 2 * S)
    assert detector.update(HERE, True, 3 * S)


@pytest.mark.parametrize(("gap_s", "stuck"), [(0.9, True), (1.1, False), (10.0, False)])
def test_time_in_which_nobody_looked_is_no_standstill(gap_s, stuck):
    detector = StuckDetector(2.0, 0.05)
    assert not any(run(detector, [HERE] * 15))
    begun_ns = 14 * S // 10 + int(gap_s * S)
    assert detector.update(HERE, True, begun_ns) == stuck
    assert not detector.update(HERE, True, begun_ns + S)
    assert detector.update(HERE, True, begun_ns + 2 * S)


def test_progress_waits_for_the_way_to_get_shorter():
    progress = Progress(5.0)
    assert all(progress.update(10.0 - 0.1 * k, k * S) for k in range(50))
    assert all(progress.update(5.2, (49 + k) * S) for k in range(5))
    assert not progress.update(5.2, 55 * S)


def test_progress_forgives_detours_but_not_for_ever():
    progress = Progress(5.0)
    lengths = [2.0, 9.0] * (DETOURS + 3)
    said = [progress.update(m, 4 * k * S) for k, m in enumerate(lengths)]
    assert all(said[: 2 * DETOURS])
    assert not said[-1]


def _recovery(weights: np.ndarray) -> Recovery:
    costmap = from_weights(Grid(weights, (0.0, 0.0), 0.1))
    return Recovery(HERE, costmap, MotionLimits.of(Robot()), 0)


def test_recovery_backs_up_where_the_map_is_open():
    recovery = _recovery(np.ones((40, 40), np.uint8))
    assert recovery.step(HERE, 1).v_mps < 0
    assert recovery.is_held(HERE)
    back = SE2(HERE.x_m - 1.01 * BACK_M, HERE.y_m, 0.0)
    assert recovery.step(back, S) is None
    assert not recovery.is_held(back)


def test_recovery_turns_where_it_is_closed_behind():
    weights = np.ones((40, 40), np.uint8)
    weights[:, :9] = 0
    recovery = _recovery(weights)
    command = recovery.step(HERE, 1)
    assert command.v_mps == 0.0
    assert command.w_radps > 0
    assert recovery.step(SE2(HERE.x_m, HERE.y_m, math.pi / 2), S) is None
    assert not recovery.is_held(HERE)


@pytest.mark.parametrize("now_ns", [TIME_NS, -1])
def test_recovery_ends_in_time(now_ns):
    assert _recovery(np.ones((40, 40), np.uint8)).step(HERE, now_ns) is None
