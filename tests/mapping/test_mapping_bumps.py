"""Where the robot was held up the map stays closed, though every ray goes through."""

from __future__ import annotations

import math

import mapping_twins as twins
import numpy as np
import pytest
from mapping_twins import SMALL, complete, look, seen_around

from edge.geometry import SE2
from edge.mapping import grid as grid_module
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap

HOME = SE2(0.0, 0.0, 0.0)
PLACE = (1.02, 0.03)
MEMORY_NS = int(SMALL.bump_memory_s * 1e9)


def assert_consistent(grid: RollingMap) -> None:
    """Inflation and bit planes are those of the occupied cells, counted from scratch."""
    state = twins.states(grid)
    np.testing.assert_array_equal(twins.window(grid, "near") > 0, state == 100)
    np.testing.assert_array_equal(twins.window(grid, "blocked") > 0, state == 100)
    np.testing.assert_array_equal(twins.window(grid, "known") > 0, twins.window(grid, "raw") > 0)
    np.testing.assert_array_equal(twins.window(grid, "frontier") > 0, twins.frontier_cells(state))


def test_without_a_bump_nothing_is_to_be_forgotten():
    grid = RollingMap(SMALL)
    grid.bump(*PLACE, 0)  # before the first frame there is no map
    grid.expire_bumps(10**18)
    grid.lift_bumps()
    assert grid.bumps_m == []
    look(grid, HOME, [])
    assert grid.state_at(*PLACE) == 0


def test_a_bump_closes_a_disc_that_no_ray_clears():
    grid = seen_around()
    grid.bump(*PLACE, 0)
    for _ in range(10 * SMALL.clear_after):
        look(grid, HOME, [])
    assert_consistent(grid)
    cells = grid.snapshot(inflated=50).cells
    assert np.count_nonzero(cells == 100) == 1
    assert grid.bumps_m == [pytest.approx((1.025, 0.025))]
    for away_m, state in ((0.0, 100), (0.19, 100), (0.26, 0)):
        assert grid.state_at(PLACE[0] + away_m, PLACE[1]) == state
        assert grid.state_at(PLACE[0], PLACE[1] - away_m) == state


@pytest.mark.parametrize(
    "open_again",
    [
        lambda grid: grid.expire_bumps(MEMORY_NS),
        lambda grid: grid.lift_bumps(),
        lambda grid: look(grid, SE2(*PLACE, 0.0), []),
    ],
    ids=["time", "lifted", "the robot stands there"],
)
def test_a_bump_is_forgotten(open_again):
    grid = seen_around()
    grid.bump(*PLACE, 0)
    look(grid, HOME, [])
    grid.expire_bumps(MEMORY_NS - 1)
    assert grid.state_at(*PLACE) == 100
    open_again(grid)
    look(grid, HOME, [])
    assert grid.state_at(*PLACE) == 0
    assert grid.bumps_m == []
    assert_consistent(grid)


def test_the_same_place_again_is_remembered_afresh():
    grid = seen_around()
    grid.bump(*PLACE, 0)
    grid.bump(-1.0, 0.0, 5)
    grid.bump(*PLACE, 10)
    grid.expire_bumps(MEMORY_NS + 9)
    assert grid.bumps_m == [pytest.approx((1.025, 0.025))]
    look(grid, HOME, [])
    assert_consistent(grid)


def test_a_known_obstacle_is_inflated_once():
    box = [(1.0, -0.1, 0.0, 1.2, 0.1, 1.0)]
    grid = RollingMap(SMALL)
    look(grid, HOME, box)
    assert grid.state_at(*PLACE) == 100
    grid.bump(*PLACE, 0)
    look(grid, HOME, box)
    assert_consistent(grid)
    grid.lift_bumps()
    look(grid, HOME, box)
    look(grid, HOME, box)
    assert_consistent(grid)
    assert grid.state_at(*PLACE) == 100


def test_what_was_lifted_beside_a_new_bump_is_closed_with_it():
    """A long sill is not felt out once more from end to end; another one is tried again."""
    grid = seen_around()
    sill = [(1.02, y) for y in (-0.8, -0.4, 0.0, 0.4)]
    for place in (*sill, (-1.0, 0.0)):
        grid.bump(*place, 0)
    grid.lift_bumps()
    grid.bump(1.02, 0.2, 1)
    look(grid, HOME, [])
    assert all(grid.state_at(*place) == 100 for place in sill)
    assert grid.state_at(-1.0, 0.0) == 0
    assert_consistent(grid)


def test_bumps_leave_with_the_part_of_the_map_that_rolls_out():
    grid = seen_around()
    strip_m = ly.WORD * grid.resolution_m
    left_m = grid._origin[0] * grid.resolution_m
    # In the strip that goes, and on both sides of its edge, within inflation of it.
    for x in (left_m + 1.0, left_m + strip_m - 0.07, left_m + strip_m + 0.07, 1.0):
        grid.bump(x, 0.0, 0)
    x, rolled = 0.0, False
    while not rolled:
        x += 0.2
        rolled = look(grid, SE2(x, 0.3, 0.0), []).rolled
        assert_consistent(grid)
    assert [bx for bx, _ in grid.bumps_m] == pytest.approx([left_m + strip_m + 0.075, 1.025])
    look(grid, SE2(x + 50.0, 0.0, 0.0), [])
    assert grid.bumps_m == []
    grid.lift_bumps()
    assert_consistent(grid)


@pytest.mark.parametrize("far", [1e9, -1e9, 40.0])
def test_outside_the_window_nothing_is_closed(far):
    grid = seen_around()
    grid.bump(far, 0.0, 0)
    assert grid.bumps_m == []


def test_no_more_are_kept_than_there_is_room_for(monkeypatch):
    monkeypatch.setattr(grid_module, "_MOST_BUMPS", 3)
    grid = seen_around()
    for k in range(5):
        grid.bump(-1.0 + 0.5 * k, 0.5, k)
    assert [round(x, 1) for x, _ in grid.bumps_m] == [0.0, 0.5, 1.0]
    look(grid, HOME, [])
    assert_consistent(grid)


def doorway() -> list[twins.Box]:
    """A wall across at x = 1 with a gap of 0.6 m."""
    return [(1.0, 0.3, 0.0, 1.1, 3.0, 2.5), (1.0, -3.0, 0.0, 1.1, -0.3, 2.5)]


@pytest.mark.parametrize("y", [-0.1, 0.0, 0.1])
def test_a_bump_in_a_doorway_cuts_off_what_is_behind_and_does_not_shut_the_robot_in(y):
    grid = RollingMap(SMALL)
    for x in np.arange(-0.6, 0.81, 0.05):
        look(grid, SE2(float(x), y, 0.0), doorway())
    at_the_sill = SE2(0.8, y, 0.0)
    complete(grid, at_the_sill)
    assert math.isfinite(grid.reach.distance_m(2.0, 0.0))
    grid.bump(*at_the_sill.ahead(0.2), 0)
    look(grid, at_the_sill, doorway())
    complete(grid, at_the_sill)
    assert grid.reach.distance_m(2.0, 0.0) == math.inf
    assert math.isfinite(grid.reach.distance_m(0.0, 0.0))
    # And it may back off the way it came, on the published map too.
    snapshot = grid.snapshot()
    x0, y0 = snapshot.origin_xy_m
    row = math.floor((y - y0) / snapshot.resolution_m)
    columns = [math.floor((x - x0) / snapshot.resolution_m) for x in (0.4, 0.6, 0.8)]
    assert (snapshot.cells[row, columns] == 0).all()
