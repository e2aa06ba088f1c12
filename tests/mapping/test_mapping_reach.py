"""Reachability: against Dijkstra, amortised over steps, across rolls, out of inflation."""

from __future__ import annotations

import math
from unittest.mock import patch

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_twins import SMALL, complete, look, room, seen_around

from edge.geometry import SE2
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap
from edge.mapping.reach_kernels import DIAGONAL, STRAIGHT
from edge.mapping.travel_cost import TravelCostField
from edge.mapping.window import Window


def explored(seed: int, per_tick: int = 12000) -> tuple[RollingMap, SE2]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-20, 20, 2)
    boxes = []
    for _ in range(4):
        bx, by = x + rng.uniform(-2, 2), y + rng.uniform(-2, 2)
        if math.hypot(bx - x, by - y) > 0.9:
            boxes.append((bx, by, 0.0, bx + 0.3, by + 0.3, 1.0))
    pose = SE2(x, y, 0.0)
    with patch("edge.mapping.grid.REACH_CELLS_PER_TICK", per_tick):
        return seen_around(boxes, pose, SMALL), pose


@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), per_tick=st.sampled_from([100, 700, 12000]))
def test_the_field_agrees_with_dijkstra(seed, per_tick):
    grid, pose = explored(seed, per_tick)
    complete(grid, pose)
    state = twins.states(grid)
    x = math.floor(pose.x_m / grid.resolution_m) - grid.window.origin[0]
    y = math.floor(pose.y_m / grid.resolution_m) - grid.window.origin[1]
    assert state[y, x] == 0
    expected = twins.geodesic(state, x, y, STRAIGHT, DIAGONAL)
    n, shift = grid.window.n, grid.window.shift
    field = grid.travel_cost._waves[grid.travel_cost._complete].distance
    field = np.roll(field, (-shift[1], -shift[0]), axis=(0, 1)).astype(np.int64) - 1
    np.testing.assert_array_equal(field, expected)
    assert n == len(field)


def test_a_step_settles_no_more_cells_than_allowed():
    grid, pose = explored(1, per_tick=100)
    field = grid.travel_cost._waves[1].distance
    for step in range(1, 20):
        grid.travel_cost.step(pose)
        # Settled cells and those in line; each settled one puts at most 8 in line.
        assert np.count_nonzero(field) <= 900 * step
    assert grid.travel_cost.generation == 0
    assert grid.travel_cost.distance_m(pose.x_m, pose.y_m) == math.inf


def test_the_nearest_cell_is_free_reached_and_nearest():
    grid, pose = explored(5)
    complete(grid, pose)
    state = twins.states(grid)
    for dx, dy in ((1.0, 0.3), (-2.0, 0.5), (0.4, -2.8), (0.0, 0.0)):
        px, py = pose.x_m + dx, pose.y_m + dy
        found = grid.travel_cost.nearest(px, py, 0.6)
        best = math.inf
        for y, x in np.argwhere(state == 0):
            cx = (x + grid.window.origin[0] + 0.5) * grid.resolution_m
            cy = (y + grid.window.origin[1] + 0.5) * grid.resolution_m
            if math.isfinite(grid.travel_cost.distance_m(cx, cy)):
                best = min(best, math.hypot(cx - px, cy - py))
        if best > 0.6:
            assert found is None
        else:
            assert math.hypot(found[0] - px, found[1] - py) == pytest.approx(best, abs=1e-9)
            assert grid.state_at(found[0], found[1]) == 0
            assert found[2] == grid.travel_cost.distance_m(found[0], found[1])


def test_a_goal_that_was_blocked_since_is_not_offered():
    grid = RollingMap(SMALL)
    look(grid, SE2(0, 0, 0), [])
    complete(grid, SE2(0, 0, 0))
    assert grid.travel_cost.nearest(1.5, 0.0, 0.05) is not None
    look(grid, SE2(0, 0, 0), [(1.4, -0.2, 0.0, 1.6, 0.2, 1.0)])
    assert grid.travel_cost.nearest(1.5, 0.0, 0.05) is None


def test_a_robot_inside_inflation_finds_a_path_out():
    grid = RollingMap(SMALL)
    look(grid, SE2(0, 0, 0), room(2.0))
    pose = SE2(1.85, 0.0, 0.0)
    assert grid.state_at(pose.x_m, pose.y_m) == 100
    complete(grid, pose)
    found = grid.travel_cost.nearest(1.0, 0.0, 0.3)
    assert found is not None
    assert found[2] == pytest.approx(0.85, abs=0.1)


def test_travel_costs_survive_a_rolled_window():
    grid = RollingMap(SMALL)
    for x in np.arange(0.0, 3.0, 0.2):
        look(grid, SE2(x, 0, 0), [])
    complete(grid, SE2(3.0, 0, 0))
    before = grid.travel_cost.distance_m(2.0, 0.0)
    x, rolled = 3.0, False
    while not rolled:
        x += 0.2
        rolled = look(grid, SE2(x, 0, 0), []).rolled
    assert grid.travel_cost.distance_m(2.0, 0.0) == before
    assert grid.travel_cost.distance_m(-50.0, 0.0) == math.inf
    assert grid.travel_cost.distance_m(2.0 + grid.window.n * grid.resolution_m, 0.0) == math.inf
    complete(grid, SE2(x, 0, 0))
    assert grid.travel_cost.distance_m(x - 1.0, 0.0) == pytest.approx(1.0, abs=0.06)


def test_a_roll_during_growth_does_not_lead_across_the_seam():
    n, dropped = 256, 64
    layers, window = ly.make_layers(n), Window(n, 1.0)
    window.placed, window.origin = True, (0, 0)
    layers.raw[:, :150] = layers.raw[:, 230:] = ly.FREE  # two areas; nothing is known between them
    for x in np.flatnonzero(layers.raw[0]):
        layers.known[:, x // ly.WORD] |= np.uint64(1 << (int(x) % ly.WORD))
    field = TravelCostField(layers, window, 2.0, ly.disc_half_widths(1.0), per_tick=400)
    pose = SE2(100.5, 128.5, 0.0)
    while not (field._waves[1].distance[:, 0] > 0).any():
        field.step(pose)
    assert field.generation == 0
    layers.raw[:, :dropped], layers.known[:, : dropped // ly.WORD] = 0, 0
    window.origin = (dropped, 0)
    while field.generation == 0:
        field.step(pose)
    assert field.distance_m(140.5, 128.5) == 40.0
    assert field.distance_m(240.5, 128.5) == math.inf


def test_many_path_lengths_agree_with_single_ones():
    grid, pose = explored(3)
    out = np.zeros(4, np.float32)
    grid.travel_cost.path_lengths_m(
        np.zeros((4, 2), np.float32), np.zeros(4, np.int8), np.ones(1), 4, out
    )
    assert np.isinf(out).all(), "no field yet"
    complete(grid, pose)
    rng = np.random.default_rng(0)
    xy_m = (rng.uniform(-3, 3, (40, 2)) + np.array([pose.x_m, pose.y_m])).astype(np.float32)
    kind, radius_m = rng.integers(0, 2, 40).astype(np.int8), np.array([0.2, 0.8])
    out = np.zeros(40, np.float32)
    grid.travel_cost.path_lengths_m(xy_m, kind, radius_m, 40, out)
    found = [
        grid.travel_cost.nearest(x, y, r)
        for (x, y), r in zip(xy_m.tolist(), radius_m[kind], strict=True)
    ]
    np.testing.assert_allclose(out, [math.inf if f is None else f[2] for f in found], rtol=1e-6)
    assert 5 < np.isfinite(out).sum() < 40


def test_the_stopping_point_is_near_and_in_sight():
    grid = RollingMap(SMALL)
    wall, thing = (1.0, -0.6, 0.0, 1.1, 2.5, 1.0), (1.5, 0.3, 0.0, 1.9, 0.7, 0.5)
    surface_m = np.array([[1.5, 0.5, 0.4]], np.float32)
    assert grid.travel_cost.stopping_point(surface_m, 0.7) is None
    for x, y in ((0.0, 0.0), (0.0, -1.2), (2.0, -1.2), (2.0, 1.8)):
        for yaw in np.arange(0, 6.4, 0.7):
            look(grid, SE2(x, y, yaw), [wall, thing, *room(2.5)])
    complete(grid, SE2(0.0, 0.5, 0.0))
    x, y, way_m = grid.travel_cost.stopping_point(surface_m, 0.7)
    assert math.hypot(x - 1.5, y - 0.5) <= 0.7
    assert x > 1.1, "not from behind the wall, though that is nearer"
    assert way_m == pytest.approx(grid.travel_cost.distance_m(x, y))
    assert grid.travel_cost.stopping_point(surface_m, 0.1) is None
    around_m = grid.travel_cost.stopping_point(surface_m, 0.7, except_disc=(x, y, 0.4))
    assert math.dist(around_m[:2], (x, y)) >= 0.4
    assert around_m[2] > way_m
    assert grid.travel_cost.stopping_point(surface_m, 0.7, except_disc=(x, y, 2.0)) is None
    # The point with the shortest path is chosen.
    more_m = np.array([[1.5, 0.5, 0.4], [1.5, -1.0, 0.4]], np.float32)
    assert grid.travel_cost.stopping_point(more_m, 0.7)[2] < way_m


def test_the_robot_does_not_stop_behind_a_wall():
    grid = RollingMap(SMALL)
    wall, thing = (1.0, -0.6, 0.0, 1.25, 2.5, 1.0), (1.25, 0.3, 0.0, 1.6, 0.7, 0.5)
    for x, y in ((0.0, 0.0), (0.0, -1.2), (2.0, -1.2), (2.0, 1.8)):
        for yaw in np.arange(0, 6.4, 0.7):
            look(grid, SE2(x, y, yaw), [wall, thing, *room(2.5)])
    complete(grid, SE2(0.0, 0.5, 0.0))
    # Depth noise puts points of a thing at a wall into the wall.
    surface_m = np.array([[1.15, 0.5, 0.4], [1.16, 0.6, 0.4], [1.6, 0.5, 0.4]], np.float32)
    for points in (1, 2):
        assert grid.travel_cost.stopping_point(surface_m, 0.85, points)[0] > 1.25, points


def test_a_few_stray_points_do_not_set_the_stop():
    grid = RollingMap(SMALL)
    for x, y in ((0.0, 0.0), (-1.0, 0.0)):
        for yaw in np.arange(0, 6.4, 0.7):
            look(grid, SE2(x, y, yaw), [(1.7, -0.5, 0.0, 2.1, 0.5, 0.7), *room(2.5)])
    complete(grid, SE2(0.0, 0.0, 0.0))
    desk_m = np.column_stack([np.full(10, 1.7), np.linspace(-0.4, 0.4, 10), np.full(10, 0.7)])
    chair_m = np.array([[1.0, 0.0, 0.5], [1.05, 0.1, 0.5]])
    surface_m = np.concatenate([desk_m, chair_m]).astype(np.float32)
    x, y, one_m = grid.travel_cost.stopping_point(surface_m, 0.7)
    assert np.hypot(*(desk_m[:, :2] - (x, y)).T).min() > 0.85, "near to the chair alone"
    x, y, three_m = grid.travel_cost.stopping_point(surface_m, 0.7, 3)
    assert np.hypot(*(desk_m[:, :2] - (x, y)).T).min() <= 0.7
    assert three_m > one_m
    assert grid.travel_cost.stopping_point(surface_m, 0.7, len(surface_m) + 1) is None


def test_without_a_field_there_is_no_path():
    assert RollingMap(SMALL).travel_cost.path_xy_m(0.0, 0.0).shape == (0, 2)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_path_is_as_long_as_the_distance(seed):
    grid, pose = explored(seed)
    complete(grid, pose)
    rng = np.random.default_rng(seed)
    res, reach = grid.resolution_m, grid.travel_cost
    for x, y in np.add(rng.uniform(-3, 3, (20, 2)), (pose.x_m, pose.y_m)):
        way, away_m = reach.path_xy_m(x, y), reach.distance_m(x, y)
        if math.isinf(away_m):
            assert len(way) == 0
            continue
        np.testing.assert_allclose(way[[0, -1]], cell_centres(res, (pose.x_m, pose.y_m), (x, y)))
        steps = np.abs(np.diff(np.rint(way / res - 0.5), axis=0))
        assert len(steps) == 0 or (steps.max() == 1 and steps.max(axis=1).min() == 1)
        cost = np.where(steps.sum(axis=1) == 2, DIAGONAL, STRAIGHT).sum() / STRAIGHT * res
        assert cost == pytest.approx(away_m)
        distances = [reach.distance_m(*map(float, cell)) for cell in way]
        assert distances == sorted(distances)


def cell_centres(res: float, *points: tuple[float, float]) -> np.ndarray:
    return (np.floor(np.array(points) / res) + 0.5) * res
