"""Standing still, getting nowhere, getting free."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import Robot
from edge.geometry import SE2, Grid
from edge.motion.progress import DETOURS, Contact, Progress
from edge.motion.pursuit import MotionLimits
from edge.motion.recovery import BACK_M, TIME_NS, Recovery
from edge.trajectory.costmap import from_weights

S = 1_000_000_000
HERE = SE2(1.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("steps", "after"),
    [
        ([], None),
        ([(0.0, 0.0)] * 50, None),  # told to stand
        ([(0.0, 0.5)] * 10, 6),  # 0.3 m in vain
        ([(0.0, -0.5)] * 10, 6),
        ([(0.0, 0.1)] * 40, 30),
        ([(0.02, 0.5)] * 50, None),  # it drives
        ([(0.0, 0.5), (0.0, -0.5)] * 20, None),  # forth and back
        ([*[(0.0, 0.5)] * 5, (0.0, 0.0)] * 5, None),  # it stopped in between
        ([*[(0.0, 0.5)] * 5, (0.06, 0.5), *[(0.0, 0.5)] * 6], 11),  # it came free once
    ],
)
def test_a_robot_pushes_that_was_told_to_drive_in_vain(steps, after):
    """Steps of 0.1 s: how far it came, at what speed it was told to drive."""
    contact, x, said = Contact(0.3, 0.05), 0.0, []
    for moved_m, v_mps in steps:
        x += moved_m
        said.append(contact.update(SE2(x, 0.0, 0.0), v_mps, 0.1))
    assert (said.index(True) + 1 if any(said) else None) == after


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
