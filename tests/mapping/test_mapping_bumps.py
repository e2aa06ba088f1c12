"""Bump cells: the map stays closed where the robot was stuck, though rays pass."""

from __future__ import annotations

import math

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_twins import SMALL, complete, look, seen_around

from edge.geometry import SE2
from edge.mapping import bumps
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap
from edge.mapping.update import MOST_FLOOR_UPDATES

HOME = SE2(0.0, 0.0, 0.0)
RADIUS_M = 0.2
PLACE = (1.02, 0.03)
MEMORY_NS = int(bumps.MEMORY_S * 1e9)
FIRST_NS = MEMORY_NS // 5  # a first touch is remembered for so long
SILL = [(1.0, -0.6, 0.0, 1.05, 0.6, 0.085)]  # too low for an obstacle, too high to drive over


def assert_consistent(grid: RollingMap) -> None:
    """Inflation and bit planes are those of the occupied cells, counted from scratch."""
    state = twins.states(grid)
    np.testing.assert_array_equal(twins.window(grid, "near") > 0, state == 100)
    np.testing.assert_array_equal(twins.window(grid, "blocked") > 0, state == 100)
    np.testing.assert_array_equal(twins.window(grid, "known") > 0, twins.window(grid, "raw") > 0)
    np.testing.assert_array_equal(twins.window(grid, "frontier") > 0, twins.frontier_cells(state))


def bump(grid: RollingMap, place: tuple[float, float], now_ns: int = 0) -> None:
    """Record a bump there while driving along x."""
    pose = SE2(place[0] - RADIUS_M, place[1], 0.0)
    grid.bumps.close(pose, place, RADIUS_M, now_ns)


def test_a_bump_closes_the_touched_cells_against_rays():
    grid = seen_around()
    bump(grid, PLACE)
    for _ in range(2 * MOST_FLOOR_UPDATES):
        look(grid, HOME, SILL)
    assert_consistent(grid)
    cells = grid.snapshot(inflated=50).cells
    rows, columns = np.nonzero(cells == 100)
    assert len(set(columns)) == 1
    assert len(rows) == 9  # as wide as the robot
    assert grid.bumps.closed_m == [PLACE]
    for away_m, state in ((0.0, 100), (0.19, 100), (0.28, 0)):
        assert grid.state_at(PLACE[0] + away_m, PLACE[1]) == state
        assert grid.state_at(PLACE[0] - away_m, PLACE[1]) == state
        assert grid.state_at(PLACE[0], PLACE[1] - RADIUS_M - away_m) == state


@pytest.mark.parametrize(
    "open_again",
    [
        lambda grid: grid.bumps.expire(FIRST_NS),
        lambda grid: grid.bumps.open_all(),
        lambda grid: look(grid, SE2(*PLACE, 0.0), []),
    ],
    ids=["time", "lifted", "the robot stands there"],
)
def test_a_bump_is_forgotten(open_again):
    grid = seen_around()
    bump(grid, PLACE, 0)
    look(grid, HOME, [])
    grid.bumps.expire(FIRST_NS - 1)
    assert grid.state_at(*PLACE) == 100
    open_again(grid)
    look(grid, HOME, [])
    assert grid.state_at(*PLACE) == 0
    assert grid.bumps.closed_m == []
    assert_consistent(grid)


def test_the_same_place_again_is_remembered_again():
    grid = seen_around()
    bump(grid, PLACE, 0)
    bump(grid, (-1.0, 0.0), 5)
    bump(grid, PLACE, 10)
    grid.bumps.expire(FIRST_NS + 9)
    assert grid.bumps.closed_m == [PLACE]
    look(grid, HOME, [])
    assert_consistent(grid)


PASSER_BY = [(1.01, -0.3, 0.0, 1.1, 0.3, 1.7)]
AWAY = SE2(0.0, 0.0, math.pi)


@pytest.mark.parametrize(
    ("looks", "touched_before", "opens"),
    [
        ([(HOME, [], MOST_FLOOR_UPDATES - 1)], False, False),
        ([(HOME, [], MOST_FLOOR_UPDATES)], False, True),
        ([(HOME, PASSER_BY, 2 * MOST_FLOOR_UPDATES)], False, False),
        ([(HOME, PASSER_BY, 5), (HOME, [], MOST_FLOOR_UPDATES)], False, True),
        ([(HOME, [], MOST_FLOOR_UPDATES - 1), (HOME, PASSER_BY, 1), (HOME, [], 1)], False, False),
        ([(HOME, SILL, 2 * MOST_FLOOR_UPDATES)], False, False),
        ([(AWAY, [], 2 * MOST_FLOOR_UPDATES)], False, False),
        ([(HOME, [], 2 * MOST_FLOOR_UPDATES)], True, False),
    ],
    ids=[
        "not yet", "floor", "someone stands there", "who stood there went", "floor, with a break",
        "a sill", "not looked at", "floor, but touched again",
    ],
)  # fmt: skip
def test_a_bump_opens_after_enough_views_of_floor(looks, touched_before, opens):
    grid = seen_around()
    bump(grid, PLACE)
    if touched_before:
        grid.bumps.open_all()
        bump(grid, PLACE, 1)
    for pose, boxes, times in looks:
        for _ in range(times):
            look(grid, pose, boxes)
    assert (grid.bumps.closed_m == []) == opens
    assert grid.bumps.known_m == [PLACE]
    assert_consistent(grid)


BOX = [(1.0, -0.1, 0.0, 1.2, 0.1, 1.0)]
BEHIND_IT = (1.8, 0.0)


def layers_at(grid: RollingMap, place: tuple[float, float]) -> tuple[int, int, bool]:
    """raw, top and known of the cell."""
    x, y = (math.floor(v / grid.resolution_m) % grid.window.n for v in place)
    layers = twins.writable(grid)
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
def test_an_opened_cell_returns_to_its_former_state(place, raw, open_again, times):
    grid = RollingMap(SMALL)
    look(grid, HOME, BOX)
    before = layers_at(grid, place)
    everywhere = grid.snapshot(inflated=50).cells
    assert before[0] == raw
    assert (before[1] > 0, before[2]) == (raw == ly.OCCUPIED, raw != ly.UNSEEN)
    for now_ns in range(times):
        bump(grid, place, now_ns)
    look(grid, HOME, BOX)
    assert layers_at(grid, place) == (ly.BUMPED, 0, True)
    assert_consistent(grid)
    open_again(grid)
    assert layers_at(grid, place) == before
    look(grid, HOME, BOX)
    assert_consistent(grid)
    np.testing.assert_array_equal(grid.snapshot(inflated=50).cells, everywhere)


def is_explained(grid: RollingMap, pose: SE2, place: tuple[float, float]) -> bool:
    inflation_m = grid.config.inflation_m
    return bumps.explained_by_obstacle(grid.layers, grid.window, inflation_m, pose, place, 0.2)


@pytest.mark.parametrize(
    ("x_m", "yaw_rad", "shows"),
    [
        (0.75, 0.0, True),  # the box stands right before the robot
        (0.65, 0.0, True),  # it begins where the inflation of the robot's front ends
        (0.4, 0.0, False),
        (0.75, math.pi, False),
        (0.75, 1.2, False),  # next to the path
        (0.82, 1.2, True),  # so too, but touched
        (0.82, 2.0, False),  # behind
    ],
)
def test_an_obstacle_ahead_explains_a_blocked_robot(x_m, yaw_rad, shows):
    empty, grid = RollingMap(SMALL), RollingMap(SMALL)
    look(grid, HOME, BOX)
    pose = SE2(x_m, 0.0, yaw_rad)
    place = pose.ahead(0.2)
    assert not is_explained(empty, pose, place)
    assert is_explained(grid, pose, place) == shows
    beside = seen_around()
    bump(beside, place)
    assert not is_explained(beside, pose, place)  # a bump explains nothing


def test_bumps_outside_the_rolled_window_are_dropped():
    grid = seen_around()
    strip_m = ly.WORD * grid.resolution_m
    left_m = grid.window.origin[0] * grid.resolution_m
    # In the strip that goes, and on both sides of its edge, within inflation of it.
    for x in (left_m + 1.0, left_m + strip_m - 0.07, left_m + strip_m + 0.07, 1.0):
        bump(grid, (x, 0.0))
    x, rolled = 0.0, False
    while not rolled:
        x += 0.2
        rolled = look(grid, SE2(x, 0.3, 0.0), []).rolled
        assert_consistent(grid)
    assert [bx for bx, _ in grid.bumps.closed_m] == pytest.approx([left_m + strip_m + 0.07, 1.0])
    look(grid, SE2(x + 50.0, 0.0, 0.0), [])
    assert grid.bumps.closed_m == []
    grid.bumps.open_all()
    assert_consistent(grid)


def test_no_more_are_kept_than_there_is_room_for(monkeypatch):
    monkeypatch.setattr(bumps, "_MAX_BUMPS", 3)
    grid = seen_around()
    for k in range(5):
        bump(grid, (-1.0 + 0.5 * k, 0.5), k)
    assert [round(x, 1) for x, _ in grid.bumps.closed_m] == [0.0, 0.5, 1.0]
    look(grid, HOME, [])
    assert_consistent(grid)


def test_the_oldest_place_again_replaces_itself_when_all_room_is_used(monkeypatch):
    monkeypatch.setattr(bumps, "_MAX_BUMPS", 3)
    grid = seen_around()
    for now_ns, k in enumerate((0, 1, 2, 0)):
        bump(grid, (-1.0 + 0.5 * k, 0.5), now_ns)
    assert [round(x, 1) for x, _ in grid.bumps.closed_m] == [-0.5, 0.0, -1.0]
    grid.bumps.open_all()
    look(grid, HOME, [])
    assert grid.state_at(-1.0, 0.5) == 0
    assert_consistent(grid)


def doorway() -> list[twins.Box]:
    """Return a wall across at x = 1 with a gap of 0.6 m."""
    return [(1.0, 0.3, 0.0, 1.1, 3.0, 2.5), (1.0, -3.0, 0.0, 1.1, -0.3, 2.5)]


@pytest.mark.parametrize("y", [-0.1, 0.0, 0.1])
def test_a_bump_in_a_doorway_closes_the_room_behind(y):
    grid = RollingMap(SMALL)
    for x in np.arange(-0.6, 0.81, 0.05):
        look(grid, SE2(float(x), y, 0.0), doorway())
    at_the_sill = SE2(0.8, y, 0.0)
    complete(grid, at_the_sill)
    assert math.isfinite(grid.travel_cost.distance_m(2.0, 0.0))
    grid.bumps.close(at_the_sill, at_the_sill.ahead(RADIUS_M), RADIUS_M, 0)
    look(grid, at_the_sill, doorway())
    complete(grid, at_the_sill)
    assert grid.travel_cost.distance_m(2.0, 0.0) == math.inf
    assert math.isfinite(grid.travel_cost.distance_m(0.0, 0.0))
    # And it may back off the way it came, on the published map too.
    snapshot = grid.snapshot()
    x0, y0 = snapshot.origin_xy_m
    row = math.floor((y - y0) / snapshot.resolution_m)
    columns = [math.floor((x - x0) / snapshot.resolution_m) for x in (0.4, 0.6, 0.8)]
    assert (snapshot.cells[row, columns] == 0).all()


def sill(*ys: float) -> RollingMap:
    """Bumps along x = 1.02, one after another, driving along x."""
    grid = seen_around()
    for k, y in enumerate(ys):
        bump(grid, (1.02, y), k)
    return grid


@pytest.mark.parametrize(
    ("ys", "closed_y"),
    [
        ((0.0,), (-0.2, 0.2)),
        ((0.0, 0.5), (-0.7, 1.2)),  # between them, and as far again beyond
        ((-0.5, 0.5, 0.0), (-1.7, 1.7)),  # no farther than a metre
    ],
)
def test_two_bumps_in_line_form_one_sill(ys, closed_y):
    cells = sill(*ys).snapshot(inflated=50)
    column = math.floor((1.02 - cells.origin_xy_m[0]) / cells.resolution_m)
    rows = np.flatnonzero(cells.cells[:, column] == 100)
    y = cells.origin_xy_m[1] + (rows + 0.5) * cells.resolution_m
    assert (y.min(), y.max()) == pytest.approx(closed_y, abs=0.06)


def test_a_sill_ends_at_obstacles_and_at_the_trail():
    grid = RollingMap(SMALL)
    for x in np.arange(-0.5, 1.51, 0.05):  # between the sill and the box it went through
        look(grid, SE2(float(x), 0.5, 0.0), [(1.0, -1.2, 0.0, 1.05, -0.82, 1.0)])
    bump(grid, (1.02, -0.4))
    bump(grid, (1.02, -0.1))
    raw = grid.layers.raw
    closed_y = [
        y for y in np.arange(-1.975, 2.0, 0.05)
        if raw[grid.window.cell_of(1.02, y)[1] % grid.window.n,
               grid.window.cell_of(1.02, y)[0] % grid.window.n] == ly.BUMPED
    ]  # fmt: skip
    assert -0.9 < min(closed_y) < -0.7
    assert 0.2 < max(closed_y) < 0.4
    look(grid, SE2(1.5, 0.5, 0.0), [])
    assert_consistent(grid)


def test_driving_over_a_bump_opens_all_its_cells():
    grid = sill(0.0)
    look(grid, SE2(1.02, 0.15, 0.0), [])
    assert grid.bumps.known_m == []
    assert grid.state_at(1.02, -0.15) == 0
    assert_consistent(grid)


@settings(max_examples=15)
@given(
    turns=st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=12),
    headings=st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=3),
)
def test_no_bump_shuts_the_robot_in(turns, headings):
    """The way that it came stays open, wherever its front was held up."""
    grid, pose = RollingMap(SMALL), HOME
    look(grid, pose, [])
    for turn in turns:
        x, y = pose.ahead(0.15)
        pose = SE2(x, y, pose.yaw_rad + turn)
        look(grid, pose, [])
    for now_ns, heading in enumerate([0.0, *headings]):
        pose = SE2(pose.x_m, pose.y_m, pose.yaw_rad + heading)
        grid.bumps.close(pose, pose.ahead(RADIUS_M), RADIUS_M, now_ns)
    look(grid, pose, [])
    complete(grid, pose)
    assert math.isfinite(grid.travel_cost.distance_m(HOME.x_m, HOME.y_m))


@pytest.mark.parametrize("radius", [0.0, 1.0, 2.5])
def test_near_the_trail_agrees_with_its_twin(radius):
    grid, rng = seen_around(), np.random.default_rng(3)
    layers = twins.writable(grid)
    layers.trail[:] = rng.integers(0, 2**63, layers.trail.shape, np.uint64)
    layers.trail[:] &= rng.integers(0, 2**63, layers.trail.shape, np.uint64)
    layers.trail[:] &= np.uint64(0x0101010101010101)
    n = grid.window.n
    on = np.array([[ly.bit_get(layers.trail, y, x) for x in range(n)] for y in range(n)])
    offset = np.arange(-3, 4)
    disc = offset[:, None] ** 2 + offset[None, :] ** 2 <= radius**2
    for y, x in rng.integers(0, n, (200, 2)).tolist():
        patch = on[np.ix_((y + offset) % n, (x + offset) % n)]
        assert ly.near_trail(layers, y, x, radius) == (patch & disc).any()
