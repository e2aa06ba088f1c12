"""Headings, speeds and times along a path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.trajectory.pursuit import MotionLimits
from edge.trajectory.speeds import speeds_mps, times_s

LIMITS = MotionLimits(speed_mps=1.0, turn_radps=1.0, accel_mps2=0.5, turn_accel_radps2=3.0)
LINE = np.column_stack([np.arange(0.0, 10.01, 0.1), np.zeros(101)])


@pytest.mark.parametrize("n", [0, 1])
def test_an_empty_path_takes_no_time(n):
    path = LINE[:n]
    speeds = speeds_mps(path, LIMITS)
    assert speeds.tolist() == [0.0] * n
    assert times_s(path, speeds, 0.5).tolist() == [0.0] * n


def test_a_line_is_a_trapezoid():
    """2 s and 1 m to full speed, 8 m at it, 2 s and 1 m to rest."""
    speeds = speeds_mps(LINE, LIMITS)
    assert speeds[[0, 10, 50, 90, 100]] == pytest.approx([0.0, 1.0, 1.0, 1.0, 0.0])
    assert speeds[5] == pytest.approx(math.sqrt(0.5))
    assert times_s(LINE, speeds, 0.5)[-1] == pytest.approx(12.0)


def test_a_circle_is_driven_at_its_turning_speed():
    angle = np.linspace(0.0, 2 * math.pi, 400)
    speeds = speeds_mps(0.5 * np.column_stack([np.cos(angle), np.sin(angle)]), LIMITS)
    assert speeds[200] == pytest.approx(0.5, rel=1e-3)


@given(st.integers(0, 2**32 - 1), st.integers(2, 60))
def test_no_limit_is_broken(seed, n):
    path = np.cumsum(np.random.default_rng(seed).normal(0, 0.2, (n, 2)), axis=0)
    speeds, legs = speeds_mps(path, LIMITS), np.hypot(*np.diff(path, axis=0).T)
    assert (speeds >= 0.0).all()
    assert speeds.max() <= LIMITS.speed_mps
    assert (np.abs(np.diff(speeds**2)) <= 2 * LIMITS.accel_mps2 * legs + 1e-9).all()
    assert (np.diff(times_s(path, speeds, LIMITS.accel_mps2)) > 0.0).all()
