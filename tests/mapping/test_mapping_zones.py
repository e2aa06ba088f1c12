"""Zones: closed for every planner, by the footprint, wherever the window is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_twins import ORIGIN, SMALL, complete, look, room, seen_around

from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.mapping.layers import ZONE
from edge.mapping.zones import MARGIN_CELLS, ZonePolygons, keepout_mask

WALLS = room(2.8)


def square(x_m: float, y_m: float, half_m: float) -> np.ndarray:
    return np.array(
        [(x_m + a * half_m, y_m + b * half_m) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


def closed(grid: RollingMap) -> np.ndarray:
    """(n, n) bool by world cell: [0, 0] is the window's lower-left cell."""
    x, y = grid.window.shift
    return np.roll(grid.layers.near & ZONE != 0, (-y, -x), axis=(0, 1))


def distance_m(polygon_m: np.ndarray, xy_m: np.ndarray) -> np.ndarray:
    """Distance of points to a convex polygon, counter-clockwise; 0 inside."""
    a, b = polygon_m, np.roll(polygon_m, -1, axis=0)
    ab, ap = b - a, xy_m[:, None] - a
    t = np.clip((ap * ab).sum(-1) / (ab * ab).sum(-1), 0.0, 1.0)
    away = np.linalg.norm(ap - t[..., None] * ab, axis=-1).min(axis=1)
    inside = (ab[:, 0] * ap[..., 1] - ab[:, 1] * ap[..., 0] >= 0).all(axis=1)
    return np.where(inside, 0.0, away)


def centres_m(grid: RollingMap) -> np.ndarray:
    n, (x, y) = grid.window.n, grid.window.origin
    column, row = np.meshgrid(np.arange(n), np.arange(n))
    return (np.stack([column + x, row + y], -1).reshape(-1, 2) + 0.5) * grid.resolution_m


def test_without_zones_nothing_is_closed():
    grid = RollingMap(SMALL)
    grid.set_zones((), ())
    look(grid, ORIGIN, WALLS)
    assert not grid.zones.any
    assert not closed(grid).any()


@settings(max_examples=10)
@given(
    x_m=st.floats(-3, 3), y_m=st.floats(-3, 3), half_m=st.floats(0.05, 1.5),
    at_m=st.tuples(st.floats(-30, 30), st.floats(-30, 30)), stays=st.booleans(),
)  # fmt: skip
def test_cells_are_closed_by_their_distance_to_the_polygon(x_m, y_m, half_m, at_m, stays):
    grid = RollingMap(SMALL)
    look(grid, SE2(*at_m, 0.0), ())
    polygon = square(at_m[0] + x_m, at_m[1] + y_m, half_m)
    grid.set_zones(*((), (polygon,)) if stays else ((polygon,), ()))
    res, least = grid.resolution_m, SMALL.inflation_m
    most = least + (MARGIN_CELLS + 3) * res
    found = closed(grid).ravel()
    if stays:  # distance to the outside: the polygon is a square
        to_m = half_m - np.abs(centres_m(grid) - polygon.mean(axis=0)).max(axis=1)
    else:
        to_m = distance_m(polygon, centres_m(grid))
    assert found[to_m <= least].all()
    assert not found[to_m > most].any()


def test_no_path_leads_through_a_zone_until_it_is_removed():
    grid = seen_around(WALLS)
    beyond = (2.0, 0.0)
    complete(grid, ORIGIN)
    assert grid.travel_cost.distance_m(*beyond) == pytest.approx(2.0, abs=0.2)
    grid.set_zones((square(1.2, 0.0, 0.3),), ())
    complete(grid, ORIGIN)
    assert 2.1 < grid.travel_cost.distance_m(*beyond) < 3.5
    assert math.isinf(grid.travel_cost.distance_m(1.2, 0.0))
    assert grid.state_at(1.2, 0.0) == 100
    grid.set_zones((np.array([(1.0, -4.0), (1.4, -4.0), (1.4, 4.0), (1.0, 4.0)]),), ())
    complete(grid, ORIGIN)
    assert math.isinf(grid.travel_cost.distance_m(*beyond))
    grid.set_zones((), ())
    complete(grid, ORIGIN)
    assert grid.travel_cost.distance_m(*beyond) == pytest.approx(2.0, abs=0.2)


def test_a_zone_removes_its_frontiers():
    grid = seen_around()
    n = grid.frontiers.n
    assert n > 0
    grid.set_zones((square(0.0, 0.0, 8.0),), ())
    look(grid, ORIGIN, ())
    assert grid.frontiers.n == 0
    grid.set_zones((), ())
    look(grid, ORIGIN, ())
    assert grid.frontiers.n == n


def test_a_robot_in_a_zone_may_leave_it():
    grid = seen_around(WALLS)
    zone = square(0.0, 0.0, 1.0)
    grid.set_zones((zone,), ())
    assert grid.zones.contains(0.0, 0.0)
    complete(grid, ORIGIN)
    assert grid.travel_cost.distance_m(2.0, 0.0) == pytest.approx(2.0, abs=0.3)
    x_m, y_m, _ = grid.travel_cost.nearest(0.0, 0.0, 3.0)
    assert not grid.zones.contains(x_m, y_m)
    complete(grid, SE2(2.2, 0.0, 0.0))  # outside it is closed again
    assert math.isinf(grid.travel_cost.distance_m(0.0, 0.0))


def test_the_trail_does_not_open_a_zone():
    grid = seen_around(WALLS)
    for x_m in np.arange(0.0, 2.0, 0.2):
        look(grid, SE2(x_m, 0.0, 0.0), WALLS)
    grid.set_zones((square(1.0, 0.0, 0.1),), ())
    complete(grid, SE2(2.0, 0.0, 0.0))
    assert math.isinf(grid.travel_cost.distance_m(1.0, 0.0))
    assert grid.snapshot().cells.max() == 100


def test_zones_keep_their_place_when_the_window_rolls():
    polygon = square(12.0, 1.0, 1.0)
    grid = RollingMap(SMALL)
    grid.set_zones((polygon,), ())
    assert not grid.zones.contains(12.0, 1.0)  # the window has no place yet
    look(grid, ORIGIN, ())
    assert not closed(grid).any()
    for x_m in np.arange(0.5, 12.0, 0.5):
        look(grid, SE2(x_m, -2.0, 0.0), ())
    assert grid.window.origin[0] > 0
    found = closed(grid).ravel()
    away_m = distance_m(polygon, centres_m(grid))
    assert found[away_m <= SMALL.inflation_m].all()
    assert not found[away_m > SMALL.inflation_m + (MARGIN_CELLS + 3) * grid.resolution_m].any()


spot = st.floats(-3.0, 3.0)


@settings(deadline=None, max_examples=30)
@given(
    steps=st.lists(st.lists(st.tuples(spot, spot), max_size=3), min_size=1, max_size=4),
    at_m=st.sampled_from([(0.0, 0.0), (40.0, -3.0)]),
)
def test_changed_zones_close_the_same_cells_as_new_ones(steps, at_m):
    step_by_step, at_once = RollingMap(SMALL), RollingMap(SMALL)
    for grid in (step_by_step, at_once):
        look(grid, SE2(*at_m, 0.0), ())
    zones: list[np.ndarray] = []
    for places in steps:
        zones = [square(x_m + at_m[0], y_m + at_m[1], 0.4) for x_m, y_m in places]
        step_by_step.set_zones(zones, [])
    at_once.set_zones(zones, [])
    np.testing.assert_array_equal(closed(step_by_step), closed(at_once))
    np.testing.assert_array_equal(step_by_step.layers.blocked, at_once.layers.blocked)


def test_without_zones_the_mask_closes_nothing():
    assert keepout_mask(ZonePolygons(), 0.05, 0.2).cells.tolist() == [[-1]]


@settings(max_examples=10)
@given(
    x_m=st.floats(-2, 2), y_m=st.floats(-2, 2), half_m=st.floats(0.05, 1.0), stays=st.booleans()
)  # fmt: skip
def test_the_mask_closes_the_same_cells_as_the_map(x_m, y_m, half_m, stays):
    grid, polygon = RollingMap(SMALL), square(x_m, y_m, half_m)
    zones = ZonePolygons((), (polygon,)) if stays else ZonePolygons((polygon,))
    look(grid, ORIGIN, WALLS)
    grid.set_zones(*zones)
    mask = keepout_mask(zones, SMALL.resolution_m, SMALL.inflation_m)
    there = [mask.cell_of(*xy_m) for xy_m in centres_m(grid)]
    masked = np.array([cell is not None and mask.cells[cell] > 0 for cell in there])
    inside = np.array([cell is not None for cell in there])
    assert (masked == closed(grid).ravel())[inside].all()
    assert stays or not closed(grid).ravel()[~inside].any()
    rim = np.concatenate([mask.cells[0], mask.cells[-1], mask.cells[:, 0], mask.cells[:, -1]])
    assert set(rim.tolist()) == {100 if stays else -1}


def test_a_large_mask_has_larger_cells():
    mask = keepout_mask(ZonePolygons((square(0.0, 0.0, 500.0),)), 0.05, 0.2)
    assert mask.resolution_m == 0.8
    assert mask.cells.size < 2**22
    assert mask.cells[mask.cell_of(500.0, 0.0)] == 100
