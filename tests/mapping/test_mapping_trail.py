"""Trail of the robot: driven gaps that look too narrow later stay open."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping_twins import SMALL, complete, look

from edge.geometry import SE2
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap

N = 64


def bits(plane: np.ndarray) -> np.ndarray:
    return np.unpackbits(plane.view(np.uint8), axis=1, bitorder="little").astype(bool)


def on_trail(raw: np.ndarray, trail: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Twin of `layers.on_trail`, for every cell of the torus at once."""
    radius = len(body) // 2
    clear = np.ones(raw.shape, bool)
    for dy in range(-radius, radius + 1):
        for dx in range(-body[dy + radius], body[dy + radius] + 1):
            clear &= np.roll(raw, (-dy, -dx), axis=(0, 1)) < ly.OCCUPIED
    return trail & clear


@given(seed=st.integers(0, 2**32 - 1), radius=st.sampled_from([0.0, 1.0, 2.5, 4.0]))
def test_on_trail_agrees_with_its_twin(seed, radius):
    rng = np.random.default_rng(seed)
    layers, body = ly.make_layers(N), ly.disc_half_widths(radius)
    layers.raw[:] = rng.choice([0, 1, 2, 5], p=[0.3, 0.66, 0.02, 0.02], size=(N, N))
    layers.trail[:] = rng.integers(0, 2**63, layers.trail.shape, dtype=np.uint64)
    found = [[ly.on_trail(layers, y, x, body) for x in range(N)] for y in range(N)]
    np.testing.assert_array_equal(found, on_trail(layers.raw, bits(layers.trail), body))


@given(
    ends=st.tuples(*[st.integers(2, N - 3)] * 4),
    shift=st.tuples(st.integers(0, N - 1), st.integers(0, N - 1)),
)
def test_a_trail_joins_its_ends_by_straight_steps(ends, shift):
    layers = ly.make_layers(N)
    ly.mark_trail(layers, *shift, *ends)
    marked = np.roll(bits(layers.trail), (-shift[1], -shift[0]), axis=(0, 1))
    x, y, x1, y1 = ends
    reached, queue = {(x, y)}, [(x, y)]
    while queue:
        x, y = queue.pop()
        for near in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if near not in reached and marked[near[1], near[0]]:
                reached.add(near)
                queue.append(near)
    assert (x1, y1) in reached
    assert len(reached) == np.count_nonzero(marked)


def drive(grid: RollingMap, xs: np.ndarray, boxes: list) -> None:
    for x in xs:
        look(grid, SE2(float(x), 0.0, 0.0), boxes)


def posts(gap_m: float) -> list:
    """Two posts next to the x axis at x = 1, with a gap between them, in a wall."""
    half = gap_m / 2
    return [(0.9, half, 0.0, 1.1, 2.5, 1.0), (0.9, -2.5, 0.0, 1.1, -half, 1.0)]


@pytest.mark.parametrize(
    ("gap_m", "open_again"),
    [(1.0, True), (0.36, True), (0.2, False)],
    ids=["wide", "as narrow as rounding makes it", "narrower than the robot"],
)
def test_a_gap_that_was_driven_through_leads_back(gap_m, open_again):
    grid = RollingMap(SMALL)  # inflation 0.2 m: a gap of 0.36 m is closed without the trail
    drive(grid, np.arange(0.0, 2.0, 0.05), [])
    for yaw in (2.6, 2.9, math.pi, -2.9, -2.6):
        look(grid, SE2(2.0, 0.0, yaw), posts(gap_m))
    home = SE2(2.0, 0.0, math.pi)
    complete(grid, home)
    way = grid.travel_cost.distance_m(0.3, 0.0)
    assert math.isfinite(way) is open_again
    snapshot = grid.snapshot()
    column = int((1.0 - snapshot.origin_xy_m[0]) / snapshot.resolution_m)
    assert (snapshot.cells[:, column] == 0).any() == open_again


def test_a_gap_that_was_never_driven_through_stays_closed():
    grid = RollingMap(SMALL)
    drive(grid, np.arange(0.0, 0.4, 0.05), posts(0.36))
    complete(grid, SE2(0.3, 0.0, 0.0))
    assert grid.travel_cost.distance_m(1.8, 0.0) == math.inf
