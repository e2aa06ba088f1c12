"""Where the robot was held up the map stays closed, though every ray goes through."""

from __future__ import annotations

import math

import mapping_twins as twins
import numpy as np
import pytest
from mapping_twins import SMALL, complete, look, seen_around

from edge.geometry import SE2
from edge.mapping import bumps
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
    grid.bumps.close(*PLACE, 0)  # before the first frame there is no map
    grid.bumps.expire(10**18)
    grid.bumps.open_all()
    assert grid.bumps.closed_m == []
    look(grid, HOME, [])
    assert grid.state_at(*PLACE) == 0


def test_a_bump_closes_a_disc_that_no_ray_clears():
    grid = seen_around()
    grid.bumps.close(*PLACE, 0)
    for _ in range(10 * SMALL.clear_after):
        look(grid, HOME, [])
    assert_consistent(grid)
    cells = grid.snapshot(inflated=50).cells
    assert np.count_nonzero(cells == 100) == 1
    assert grid.bumps.closed_m == [pytest.approx((1.025, 0.025))]
    for away_m, state in ((0.0, 100), (0.19, 100), (0.26, 0)):
        assert grid.state_at(PLACE[0] + away_m, PLACE[1]) == state
        assert grid.state_at(PLACE[0], PLACE[1] - away_m) == state


@pytest.mark.parametrize(
    "open_again",
    [
        lambda grid: grid.bumps.expire(MEMORY_NS),
        lambda grid: grid.bumps.open_all(),
        lambda grid: look(grid, SE2(*PLACE, 0.0), []),
    ],
    ids=["time", "lifted", "the robot stands there"],
)
def test_a_bump_is_forgotten(open_again):
    grid = seen_around()
    grid.bumps.close(*PLACE, 0)
    look(grid, HOME, [])
    grid.bumps.expire(MEMORY_NS - 1)
    assert grid.state_at(*PLACE) == 100
    open_again(grid)
    look(grid, HOME, [])
    assert grid.state_at(*PLACE) == 0
    assert grid.bumps.closed_m == []
    assert_consistent(grid)


def test_the_same_place_again_is_remembered_afresh():
    grid = seen_around()
    grid.bumps.close(*PLACE, 0)
    grid.bumps.close(-1.0, 0.0, 5)
    grid.bumps.close(*PLACE, 10)
    grid.bumps.expire(MEMORY_NS + 9)
    assert grid.bumps.closed_m == [pytest.approx((1.025, 0.025))]
    look(grid, HOME, [])
    assert_consistent(grid)


BOX = [(1.0, -0.1, 0.0, 1.2, 0.1, 1.0)]
BEHIND_IT = (1.8, 0.0)


def layers_at(grid: RollingMap, place: tuple[float, float]) -> tuple[int, int, bool]:
    """raw, top and known of the cell."""
    x, y = (math.floor(v / grid.resolution_m) % grid.window.n for v in place)
    layers = grid._layers
    return int(layers.raw[y, x]), int(layers.top[y, x]), bool(ly.bit_get(layers.known, y, x))


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize(
    "open_again", [lambda g: g.bumps.open_all(), lambda g: g.bumps.expire(10**18)]
)
@pytest.mark.parametrize(
    ("place", "raw"),
    [((0.6, 0.0), ly.FREE), (PLACE, ly.OCCUPIED), (BEHIND_IT, ly.UNSEEN)],
    ids=["free", "occupied", "unseen"],
)
def test_an_opened_cell_is_what_it_was(place, raw, open_again, times):
    grid = RollingMap(SMALL)
    look(grid, HOME, BOX)
    before = layers_at(grid, place)
    everywhere = grid.snapshot(inflated=50).cells
    assert before[0] == raw
    assert (before[1] > 0, before[2]) == (raw == ly.OCCUPIED, raw != ly.UNSEEN)
    for now_ns in range(times):
        grid.bumps.close(*place, now_ns)
    look(grid, HOME, BOX)
    assert layers_at(grid, place) == (ly.BUMPED, 0, True)
    assert_consistent(grid)
    open_again(grid)
    assert layers_at(grid, place) == before
    look(grid, HOME, BOX)
    assert_consistent(grid)
    np.testing.assert_array_equal(grid.snapshot(inflated=50).cells, everywhere)


@pytest.mark.parametrize("place", [PLACE, BEHIND_IT], ids=["occupied", "unseen"])
def test_where_the_robot_stands_is_free_whatever_was_seen_there(place):
    grid = RollingMap(SMALL)
    look(grid, HOME, BOX)
    grid.bumps.close(*place, 0)
    look(grid, SE2(*place, 0.0), [])
    assert layers_at(grid, place) == (ly.FREE, 0, True)
    assert_consistent(grid)


def test_where_it_was_held_up_is_known_after_the_opening_too():
    grid = seen_around()
    assert grid.bumps.known_m == []
    for k, place in enumerate([PLACE, (-1.0, 0.0), (0.0, 1.0)]):
        grid.bumps.close(*place, k)
    assert grid.bumps.known_m == grid.bumps.closed_m
    held_up = grid.bumps.known_m
    assert grid.bumps.open_all()
    assert (grid.bumps.closed_m, grid.bumps.known_m) == ([], held_up)
    assert not grid.bumps.open_all()
    look(grid, SE2(-1.0, 0.0, 0.0), [])  # nothing holds it up there
    assert grid.bumps.known_m == [held_up[0], held_up[2]]
    grid.bumps.close(*PLACE, 5)
    assert grid.bumps.known_m == [held_up[2], held_up[0]]
    grid.bumps.expire(MEMORY_NS + 2)
    assert grid.bumps.known_m == [held_up[0]]
    grid.bumps.expire(MEMORY_NS + 5)
    assert grid.bumps.known_m == []


@pytest.mark.parametrize(
    ("x_m", "yaw_rad", "shows"),
    [
        (0.75, 0.0, True),  # the box stands right before the robot
        (0.65, 0.0, True),  # it begins where the inflation of the robot's front ends
        (0.4, 0.0, False),
        (0.75, math.pi, False),
        (0.75, 1.2, False),  # beside the way
    ],
)
def test_an_obstacle_on_the_way_explains_why_the_robot_is_held_up(x_m, yaw_rad, shows):
    empty, grid = RollingMap(SMALL), RollingMap(SMALL)
    look(grid, HOME, BOX)
    pose = SE2(x_m, 0.0, yaw_rad)
    place = pose.ahead(0.2)
    assert not empty.bumps.explained(pose, place, 0.2)
    assert grid.bumps.explained(pose, place, 0.2) == shows
    beside = seen_around()
    beside.bumps.close(*place, 0)
    assert not beside.bumps.explained(pose, place, 0.2)  # a bump explains nothing


def test_what_was_lifted_beside_a_new_bump_is_closed_with_it():
    """A long sill is not felt out once more from end to end; another one is tried again."""
    grid = seen_around()
    sill = [(1.02, y) for y in (-0.8, -0.4, 0.0, 0.4)]
    for place in (*sill, (-1.0, 0.0)):
        grid.bumps.close(*place, 0)
    grid.bumps.open_all()
    grid.bumps.close(1.02, 0.2, 1)
    look(grid, HOME, [])
    assert all(grid.state_at(*place) == 100 for place in sill)
    assert grid.state_at(-1.0, 0.0) == 0
    assert_consistent(grid)


def test_bumps_leave_with_the_part_of_the_map_that_rolls_out():
    grid = seen_around()
    strip_m = ly.WORD * grid.resolution_m
    left_m = grid.window.origin[0] * grid.resolution_m
    # In the strip that goes, and on both sides of its edge, within inflation of it.
    for x in (left_m + 1.0, left_m + strip_m - 0.07, left_m + strip_m + 0.07, 1.0):
        grid.bumps.close(x, 0.0, 0)
    x, rolled = 0.0, False
    while not rolled:
        x += 0.2
        rolled = look(grid, SE2(x, 0.3, 0.0), []).rolled
        assert_consistent(grid)
    assert [bx for bx, _ in grid.bumps.closed_m] == pytest.approx([left_m + strip_m + 0.075, 1.025])
    look(grid, SE2(x + 50.0, 0.0, 0.0), [])
    assert grid.bumps.closed_m == []
    grid.bumps.open_all()
    assert_consistent(grid)


@pytest.mark.parametrize("far", [1e9, -1e9, 40.0])
def test_outside_the_window_nothing_is_closed(far):
    grid = seen_around()
    grid.bumps.close(far, 0.0, 0)
    assert grid.bumps.closed_m == []


def test_no_more_are_kept_than_there_is_room_for(monkeypatch):
    monkeypatch.setattr(bumps, "_MOST", 3)
    grid = seen_around()
    for k in range(5):
        grid.bumps.close(-1.0 + 0.5 * k, 0.5, k)
    assert [round(x, 1) for x, _ in grid.bumps.closed_m] == [0.0, 0.5, 1.0]
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
    grid.bumps.close(*at_the_sill.ahead(0.2), 0)
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
