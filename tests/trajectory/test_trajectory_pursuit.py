"""Pure pursuit stays within the robot's limits and turns the right way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import RobotConfig
from edge.geometry import SE2
from edge.trajectory import pursuit
from edge.trajectory.pursuit import MotionLimits, VelocityCommand

LIMITS = MotionLimits.of(RobotConfig())
coordinates = st.floats(-20, 20)
angles = st.floats(-math.pi, math.pi)
ROUNDING = 1 + 1e-9


@given(coordinates, coordinates, angles, coordinates, coordinates, st.floats(0, 50))
def test_pursuit_is_within_limits_and_never_drives_back(x, y, yaw, to_x, to_y, remaining):
    pose = SE2(x, y, yaw)
    command = pursuit.pursue(pose, to_x, to_y, remaining, LIMITS)
    assert 0.0 <= command.v_mps <= LIMITS.speed_mps * ROUNDING
    assert abs(command.w_radps) <= LIMITS.turn_radps * ROUNDING
    bearing = pose.bearing_to(to_x, to_y)
    if command.w_radps != 0.0:
        assert math.copysign(1, command.w_radps) == math.copysign(1, bearing)


@given(
    st.floats(-9, 9), st.floats(-9, 9), st.floats(-0.5, 0.5), st.floats(-1, 1), st.floats(0, 0.2)
)
def test_ramp_keeps_to_the_accelerations(v, w, last_v, last_w, dt):
    last = VelocityCommand(last_v, last_w)
    got = LIMITS.ramp(LIMITS.clip(v, w), last, dt)
    assert abs(got.v_mps - last_v) <= LIMITS.accel_mps2 * dt + 1e-9
    assert abs(got.w_radps - last_w) <= LIMITS.turn_accel_radps2 * dt + 1e-9
    assert abs(got.v_mps) <= LIMITS.speed_mps * ROUNDING
    assert abs(got.w_radps) <= max(LIMITS.turn_radps, abs(last_w)) * ROUNDING


@pytest.mark.parametrize(
    ("x", "y", "remaining", "forward", "turning"),
    [
        (0.0, 0.0, 0.0, 0, 0),
        (1.0, 0.0, 5.0, 1, 0),
        (0.0, 1.0, 5.0, 0, 1),
        (0.0, -1.0, 5.0, 0, -1),
        (-1.0, -0.1, 5.0, 0, -1),
        (1.0, 0.3, 5.0, 1, 1),
    ],
)
def test_cases(x, y, remaining, forward, turning):
    command = pursuit.pursue(SE2(0.0, 0.0, 0.0), x, y, remaining, LIMITS)
    assert np.sign(command.v_mps) == forward
    assert np.sign(command.w_radps) == turning


def test_slower_near_the_goal():
    speeds = [
        pursuit.pursue(SE2(0.0, 0.0, 0.0), 0.4, 0.0, left, LIMITS).v_mps
        for left in (0.01, 0.05, 0.1, 1.0)
    ]
    assert speeds == sorted(speeds)
    assert speeds[0] < 0.5 * LIMITS.speed_mps < speeds[-1] == LIMITS.speed_mps


@pytest.mark.parametrize("yaw", [-3.0, -0.5, 0.5, 3.0])
def test_turn_to_takes_the_shorter_turn(yaw):
    command = pursuit.turn_to(SE2(0.0, 0.0, 3.1), yaw, LIMITS)
    short = (yaw - 3.1 + math.pi) % (2 * math.pi) - math.pi
    assert command.v_mps == 0.0
    assert math.copysign(1, command.w_radps) == math.copysign(1, short)


LINE = np.stack([np.linspace(0, 2, 21), np.zeros(21)], axis=1)


@pytest.mark.parametrize(
    ("x", "start", "index"), [(0.0, 0, 0), (0.52, 0, 5), (0.0, 7, 7), (9.0, 0, 20), (9.0, 20, 20)]
)
def test_nearest_index(x, start, index):
    assert pursuit.nearest_index(LINE, x, 0.3, start) == index


@pytest.mark.parametrize(
    ("index", "ahead", "wanted"), [(0, 0.05, 1), (0, 0.45, 5), (18, 5.0, 20), (20, 0.1, 20)]
)
def test_index_ahead(index, ahead, wanted):
    assert pursuit.index_ahead(LINE, index, ahead) == wanted
