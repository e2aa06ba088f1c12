"""Standing still under orders to move."""

from __future__ import annotations

import pytest

from edge.geometry import SE2
from edge.stuck import StuckDetector

S = 1_000_000_000
HERE = SE2(1.0, 2.0, 0.0)


def run(detector, poses, moving=True, step_ns=S // 10):
    return [detector.update(p, moving, k * step_ns) for k, p in enumerate(poses)]


def test_standing_still_is_stuck_once_in_every_wait():
    said = run(StuckDetector(2.0, 0.05), [HERE] * 45)
    assert [k for k, stuck in enumerate(said) if stuck] == [20, 40]


def test_a_robot_without_a_command_is_not_stuck():
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
def test_a_pause_suspends_the_stuck_timer(pause_s):
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
def test_a_gap_in_observations_is_not_a_standstill(gap_s, stuck):
    detector = StuckDetector(2.0, 0.05)
    assert not any(run(detector, [HERE] * 15))
    begun_ns = 14 * S // 10 + int(gap_s * S)
    assert detector.update(HERE, True, begun_ns) == stuck
    assert not detector.update(HERE, True, begun_ns + S)
    assert detector.update(HERE, True, begun_ns + 2 * S)
