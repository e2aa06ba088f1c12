"""Standing still, getting nowhere, getting free."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import RobotConfig
from edge.geometry import SE2, Grid, wrap_angle
from edge.lab.motion.progress import DETOURS, ContactDetector, ProgressMonitor
from edge.lab.motion.recovery import BACK_M, STEP_M, TIME_NS, BacktrackPath, Recovery
from edge.trajectory.costmap import from_weights
from edge.trajectory.pursuit import MotionLimits

S = 1_000_000_000
HERE = SE2(1.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("steps", "after"),
    [
        ([], None),
        ([(0.0, 0.0)] * 50, None),  # commanded to stand
        ([(0.0, 0.5)] * 10, 6),  # 0.3 m in vain
        ([(0.0, -0.5)] * 10, 6),
        ([(0.0, 0.1)] * 40, 30),
        ([(0.02, 0.5)] * 50, None),  # it drives
        ([(0.0, 0.5), (0.0, -0.5)] * 20, None),  # forth and back
        ([*[(0.0, 0.5)] * 5, (0.0, 0.0)] * 5, None),  # it stopped in between
        ([*[(0.0, 0.5)] * 5, (0.06, 0.5), *[(0.0, 0.5)] * 6], 11),  # it came free once
    ],
)
def test_a_robot_that_moves_less_than_commanded_is_pushing(steps, after):
    """Steps of 0.1 s: the distance driven, and the commanded speed."""
    contact, x, said = ContactDetector(0.3, 0.05), 0.0, []
    for moved_m, v_mps in steps:
        x += moved_m
        said.append(contact.update(SE2(x, 0.0, 0.0), v_mps, 0.1))
    assert (said.index(True) + 1 if any(said) else None) == after


def test_progress_waits_for_a_shorter_path():
    progress = ProgressMonitor(5.0)
    assert all(progress.update(10.0 - 0.1 * k, k * S) for k in range(50))
    assert all(progress.update(5.2, (49 + k) * S) for k in range(5))
    assert not progress.update(5.2, 55 * S)


def test_progress_forgives_a_limited_number_of_detours():
    progress = ProgressMonitor(5.0)
    lengths = [2.0, 9.0] * (DETOURS + 3)
    said = [progress.update(m, 4 * k * S) for k, m in enumerate(lengths)]
    assert all(said[: 2 * DETOURS])
    assert not said[-1]


def _recovery(weights: np.ndarray) -> Recovery:
    costmap = from_weights(Grid(weights, (0.0, 0.0), 0.1))
    return Recovery(HERE, costmap, BacktrackPath(), MotionLimits.of(RobotConfig()), 0)


def test_recovery_backs_up_in_open_space():
    recovery = _recovery(np.ones((40, 40), np.uint8))
    assert recovery.step(HERE, 1).v_mps < 0
    assert recovery.is_held(HERE)
    back = SE2(HERE.x_m - 1.01 * BACK_M, HERE.y_m, 0.0)
    assert recovery.step(back, S) is None
    assert not recovery.is_held(back)


def test_recovery_turns_if_blocked_behind():
    weights = np.ones((40, 40), np.uint8)
    weights[:, :9] = 0
    recovery = _recovery(weights)
    command = recovery.step(HERE, 1)
    assert command.v_mps == 0.0
    assert command.w_radps > 0
    assert recovery.step(SE2(HERE.x_m, HERE.y_m, math.pi / 2), S) is None
    assert not recovery.is_held(HERE)


@pytest.mark.parametrize(
    ("closed", "away_rad"),
    [
        ([], math.pi),  # back
        ([(20, 9)], 0.0),  # row and column of a closed cell: behind
        ([(20, 12), (21, 12)], math.pi),  # ahead
        ([(22, 10)], -math.pi / 2),  # on the left
        ([(22, 10), (18, 10)], math.pi),  # on both sides
        ([(20, 9), (20, 11), (21, 10), (19, 10)], None),  # all around: turn
        ([(20, 9), (24, 10)], 0.0),  # the far cell does not count
    ],
)
def test_recovery_drives_away_from_closed_cells(closed, away_rad):
    weights = np.ones((40, 40), np.uint8)
    for cell in closed:
        weights[cell] = 0
    costmap = from_weights(Grid(weights, (-0.05, -0.05), 0.1))
    recovery, pose = Recovery(HERE, costmap, None, MotionLimits.of(RobotConfig()), 0), HERE
    for k in range(80):
        command = recovery.step(pose, k * S // 20)
        if command is None:
            break
        x, y = pose.ahead(command.v_mps / 20)
        pose = SE2(x, y, pose.yaw_rad + command.w_radps / 20)
    assert recovery.has_moved(pose) == (away_rad is not None)
    if away_rad is not None:
        assert abs(wrap_angle(HERE.bearing_to(pose.x_m, pose.y_m) - away_rad)) < 0.3


@pytest.mark.parametrize("now_ns", [TIME_NS, -1])
def test_recovery_ends_in_time(now_ns):
    assert _recovery(np.ones((40, 40), np.uint8)).step(HERE, now_ns) is None


@pytest.mark.parametrize("turned_rad", [0.0, 0.4, math.pi / 2, math.pi])
def test_recovery_drives_back_along_the_trail(turned_rad):
    """Round a corner too, whatever the map says, and however the robot has turned since."""
    trail, way = BacktrackPath(), [(0.05 * k, 0.0) for k in range(20)] + [(0.95, 0.05), (0.95, 0.1)]
    for x, y in way:
        trail.extend(SE2(x, y, 0.0))
    pose = SE2(0.95, 0.1, math.pi / 2 + turned_rad)
    recovery = Recovery(pose, None, trail, MotionLimits.of(RobotConfig()), 0)
    driven, step_s = [pose], 0.05
    for k in range(100):
        command = recovery.step(pose, int(k * step_s * 1e9))
        if command is None:
            break
        x, y = pose.ahead(command.v_mps * step_s)
        pose = SE2(x, y, pose.yaw_rad + command.w_radps * step_s)
        driven.append(pose)
    assert pose.distance_to(*way[-1]) >= BACK_M - STEP_M
    assert all(min(at.distance_to(*there) for there in way) < 0.06 for at in driven)


def test_the_trail_drops_loops_and_restarts_after_a_jump():
    trail = BacktrackPath()
    assert trail.back_from(HERE) == []
    for x in (0.0, 0.1, 0.2, 0.3, 0.4, 0.3, 0.2):
        trail.extend(SE2(x, 0.0, 0.0))
    assert list(trail.xy_m) == [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0)]
    trail.extend(SE2(5.0, 0.0, 0.0))
    assert list(trail.xy_m) == [(5.0, 0.0)]
