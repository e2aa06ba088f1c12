"""Driving distances on small maps with walls, and the kernels against plain twins."""

from __future__ import annotations

import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mission_plan_twins import grid_dijkstra

from edge.geometry import Grid
from edge.mission.planning import distances as d

INF = math.inf
NO_PLACE = np.zeros((0, 2))


def at(*points: tuple[float, float]) -> np.ndarray:
    return np.array(points, np.float64).reshape(-1, 2)


def room(width_m: float, height_m: float, resolution_m=0.05, origin=(0.0, 0.0), value=0):
    shape = round(height_m / resolution_m), round(width_m / resolution_m)
    return Grid(np.full(shape, value, np.int8), origin, resolution_m)


def fill(snapshot, x0, y0, x1, y1, value=100):
    """Set the cells of a rectangle in metres."""
    (ox, oy), res = snapshot.origin_xy_m, snapshot.resolution_m
    rows = slice(round((y0 - oy) / res), round((y1 - oy) / res))
    snapshot.cells[rows, round((x0 - ox) / res) : round((x1 - ox) / res)] = value


def test_the_path_leads_through_the_door():
    """A wall across the middle with a door at the far end, left open by its inflation."""
    house = room(8, 6)
    fill(house, 0, 2.7, 8, 3.3, 99)
    fill(house, 0, 2.95, 8, 3.05)
    fill(house, 7, 2.7, 7.4, 3.3, 0)
    out = d.distances(house, (1.1, 1.1), [at((1.1, 4.9)), at((4.1, 1.1))])
    assert out[2, 1] == pytest.approx(3.0, abs=0.01)
    # From (1.1, 1.1) to the door at (7.2, 2.7), through it, and back to (1.1, 4.9).
    one_side = 1.6 * math.sqrt(2) + (6.1 - 1.6)
    assert out[2, 0] == pytest.approx(2 * one_side + 0.6, abs=0.5)
    fill(house, 7, 2.95, 7.4, 3.05)
    closed = d.distances(house, (1.1, 1.1), [at((1.1, 4.9)), at((4.1, 1.1))])
    np.testing.assert_allclose(closed, [[0, INF], [INF, 0], [INF, 3.0]], atol=0.01)


@pytest.mark.parametrize("slope", [-1.0, -0.5, 0.3, 1.0])
def test_a_wall_of_one_cell_has_no_gaps(slope):
    """In any direction, and with no inflation next to it."""
    snapshot = room(6, 6)
    for col in range(120):
        rows = 60 + slope * (np.array([col, col + 1]) - 60)
        low, high = sorted(int(v) for v in np.floor(np.clip(rows, 0, 119)))
        snapshot.cells[low : high + 1, col] = 100
    out = d.distances(snapshot, (3.0, 0.1), [at((3.0, 5.9))])
    assert np.isinf(out[1, 0])


@pytest.mark.parametrize(("half_m", "found"), [(0.3, True), (1.0, True), (1.5, False)])
def test_an_object_is_reached_next_to_it(half_m, found):
    """It stands in the middle of occupied cells."""
    snapshot = room(8, 4)
    fill(snapshot, 5 - half_m, 2 - half_m, 5 + half_m, 2 + half_m)
    out = d.distances(snapshot, (1.1, 2.1), [at((5.0, 2.0))])
    assert np.isfinite(out[1, 0]) == found
    if found:
        assert out[1, 0] == pytest.approx(5.0 - half_m - 1.1, abs=0.35)


def test_an_object_at_a_wall_has_no_path_from_behind():
    """It stands against the wall, whose other side is hardly farther from its middle."""
    house = room(6, 4)
    fill(house, 2.7, 0, 3.3, 4, 99)
    fill(house, 2.95, 0, 3.05, 4)
    fill(house, 2.3, 1.5, 2.95, 2.5, 99)
    fill(house, 2.55, 1.75, 2.95, 2.25)
    out = d.distances(house, (5.1, 2.1), [at((2.75, 2.0))])
    assert np.isinf(out[1, 0])
    assert np.isfinite(d.distances(house, (0.5, 2.1), [at((2.75, 2.0))])[1, 0])


# --- twins ---


def coarse_twin(cells, factor):
    h, w = -(-cells.shape[0] // factor), -(-cells.shape[1] // factor)
    out = np.zeros((h + 2, w + 2), np.uint8)
    for r in range(h):
        for c in range(w):
            block = cells[r * factor : (r + 1) * factor, c * factor : (c + 1) * factor]
            if (block == 100).any():
                out[r + 1, c + 1] = d.CLOSED
            elif (block == 0).any():
                out[r + 1, c + 1] = d.FREE
            elif (block == -1).any():
                out[r + 1, c + 1] = d.UNKNOWN
    return out


def random_cells(seed: int, h: int, w: int, closed: float) -> np.ndarray:
    p = [0.2, 0.8 - closed, closed / 2, closed / 2]
    return np.random.default_rng(seed).choice([-1, 0, 50, 100], (h, w), p=p).astype(np.int8)


@given(
    seed=st.integers(0, 9999), h=st.integers(1, 17), w=st.integers(1, 17), factor=st.integers(1, 5)
)
def test_coarsen_agrees_with_numpy(seed, h, w, factor):
    cells = random_cells(seed, h, w, 0.3)
    out = np.zeros((-(-h // factor) + 2, -(-w // factor) + 2), np.uint8)
    d.coarsen(cells, factor, out)
    np.testing.assert_array_equal(out, coarse_twin(cells, factor))


@given(
    seed=st.integers(0, 9999),
    h=st.integers(1, 20),
    w=st.integers(1, 20),
    starts=st.integers(0, 4),
    unknown=st.integers(1, 9),
)
def test_wavefront_agrees_with_a_heap(seed, h, w, starts, unknown):
    state = coarse_twin(random_cells(seed, h, w, 0.3), 1)
    open_cells = np.flatnonzero(state)
    rng = np.random.default_rng(seed)
    cells = rng.permutation(open_cells)[:starts]
    start = np.stack([cells, rng.integers(0, 60, cells.size)], axis=1)
    step = np.array([[0, 12, 12 * unknown], [0, 17, 17 * unknown]], np.int32)
    distance = np.empty(state.shape, np.int32)
    queue = np.empty((2, 8 * state.size + len(start)), np.int32)
    buckets = np.empty(256, np.int32)
    d.wavefront(state, step, start, distance, buckets, queue)
    np.testing.assert_array_equal(distance, grid_dijkstra(state, step, start))


@given(
    seed=st.integers(0, 9999),
    x=st.floats(-5, 20),
    y=st.floats(-5, 20),
    radius=st.sampled_from([0.5, 2.0, 6.0]),
)
def test_nearest_cell_agrees_with_a_search_of_all(seed, x, y, radius):
    state = coarse_twin(random_cells(seed, 12, 14, 0.7), 1)
    found = d.nearest_cell(state, x, y, radius)
    rows, cols = np.nonzero(state)
    d2 = (cols + 0.5 - x) ** 2 + (rows + 0.5 - y) ** 2
    inside = [(state[r, c], v) for r, c, v in zip(rows, cols, d2, strict=True) if v <= radius**2]
    if not inside:
        assert found == -1
        return
    r, c = divmod(found, state.shape[1])
    best, least = min(inside)
    assert state[r, c] == best
    assert (c + 0.5 - x) ** 2 + (r + 0.5 - y) ** 2 == pytest.approx(least)


@given(seed=st.integers(0, 9999), x=st.floats(0, 14), y=st.floats(0, 12))
def test_around_agrees_with_a_graph(seed, x, y):
    state = coarse_twin(random_cells(seed, 12, 14, 0.5), 1)
    cell = d.nearest_cell(state, x, y, 6.0)
    if cell < 0:
        return
    row, col = divmod(cell, state.shape[1])
    radius = math.sqrt(2) * math.hypot(col + 0.5 - x, row + 0.5 - y) + 2.0
    graph = nx.grid_2d_graph(*state.shape)
    for r, c in list(graph):
        if state[r, c] != state[row, col] or math.hypot(c + 0.5 - x, r + 0.5 - y) > radius + 1e-9:
            graph.remove_node((r, c))
    expected = {r * state.shape[1] + c for r, c in nx.node_connected_component(graph, (row, col))}
    found = d.around(state, x, y, cell)
    assert found[0].tolist() == [cell, 0]
    assert sorted(found[:, 0]) == sorted(expected)
    rows, cols = np.divmod(found[:, 0], state.shape[1])
    far = np.hypot(cols + 0.5 - x, rows + 0.5 - y)
    np.testing.assert_allclose(found[:, 1], (far - far[0]) * d.STRAIGHT, atol=0.501)
