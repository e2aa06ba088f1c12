"""Places where the robot was held up are closed for a while."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.geometry import SE2
from edge.motion.bumps import AHEAD_M, KEEP_NS, RADIUS_M, Bumps

RES_M = 0.05
ORIGIN = (-1.0, -0.5)


def closed(bumps: Bumps, now_ns: int = 0) -> np.ndarray:
    """Centres (n, 2) of the cells that are occupied."""
    cells = bumps.close(np.zeros((40, 60), np.int8), ORIGIN, RES_M, now_ns)
    rows, columns = np.nonzero(cells == 100)
    return np.stack([columns, rows], axis=1) * RES_M + np.array(ORIGIN) + RES_M / 2


def test_no_bump_changes_nothing():
    cells = np.zeros((4, 5), np.int8)
    assert Bumps().close(cells, ORIGIN, RES_M, 0) is cells


@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("yaw", [0.0, 1.1, -2.9])
def test_a_disc_in_the_way_is_closed(forward, yaw):
    bumps = Bumps()
    bumps.add(SE2(0.31, 0.42, yaw), forward, 0)
    ahead = AHEAD_M if forward else -AHEAD_M
    centre = np.array([0.31 + ahead * math.cos(yaw), 0.42 + ahead * math.sin(yaw)])
    every = (np.mgrid[:60, :40].reshape(2, -1).T + 0.5) * RES_M + ORIGIN
    inside = every[np.hypot(*(every - centre).T) <= RADIUS_M]
    assert len(inside) > 8
    np.testing.assert_allclose(sorted(closed(bumps).tolist()), sorted(inside.tolist()), atol=1e-9)


def test_the_map_that_came_is_not_changed():
    bumps, cells = Bumps(), np.zeros((40, 60), np.int8)
    bumps.add(SE2(0.0, 0.0, 0.0), True, 0)
    assert bumps.close(cells, ORIGIN, RES_M, 0).any()
    assert not cells.any()


@pytest.mark.parametrize("place", [(-9.0, 0.0), (9.0, 0.0), (0.0, -9.0), (0.0, 9.0), (-1.1, -0.6)])
def test_off_the_map_is_no_fault(place):
    bumps = Bumps()
    bumps.add(SE2(*place, 0.0), True, 0)
    assert len(closed(bumps)) < 12


def test_bumps_are_forgotten_in_time_and_when_the_clock_is_set_back():
    for then_ns in (KEEP_NS, -1):
        bumps = Bumps()
        bumps.add(SE2(0.0, 0.0, 0.0), True, 0)
        assert len(closed(bumps, KEEP_NS - 1)) > 0
        assert len(closed(bumps, then_ns)) == 0
        assert len(bumps) == 0


def test_no_more_are_kept_than_there_is_room_for():
    bumps = Bumps(capacity=2)
    for x in (0.0, 0.5, 1.0):
        bumps.add(SE2(x, 0.0, 0.0), True, 0)
    assert len(bumps) == 2
    assert closed(bumps)[:, 0].min() > 0.5
