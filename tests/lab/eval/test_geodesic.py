"""The distance field against Dijkstra on random plans."""

from __future__ import annotations

import heapq
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.lab.eval import geodesic
from edge.lab.sim.base import FloorPlan, WorldObject


def dijkstra(free: np.ndarray, starts: list[tuple[int, int]]) -> np.ndarray:
    best = np.full(free.shape, np.inf)
    queue = [(0.0, *start) for start in starts]
    for _, r, c in queue:
        best[r, c] = 0.0
    while queue:
        d, r, c = heapq.heappop(queue)
        for rr in range(max(r - 1, 0), min(r + 2, free.shape[0])):
            for cc in range(max(c - 1, 0), min(c + 2, free.shape[1])):
                further = d + math.hypot(rr - r, cc - c)
                if free[rr, cc] and further < best[rr, cc] - 1e-9:
                    best[rr, cc] = further
                    heapq.heappush(queue, (further, rr, cc))
    return best


@given(seed=st.integers(0, 2**32 - 1), walls=st.floats(0, 0.6))
def test_sweeping_agrees_with_dijkstra(seed, walls):
    rng = np.random.default_rng(seed)
    free = rng.random((17, 23)) > walls
    starts = [(r, c) for r, c in rng.integers(0, (17, 23), (3, 2)).tolist() if free[r, c]]
    distance = np.full(free.shape, np.inf)
    for r, c in starts:
        distance[r, c] = 0.0
    while geodesic.relax(free, distance):
        pass
    np.testing.assert_allclose(distance, dijkstra(free, starts), atol=1e-6)


def room() -> FloorPlan:
    """Return a 4 m by 2 m corridor with walls around it."""
    occupied = np.ones((50, 90), np.uint8)
    occupied[5:45, 5:85] = 0
    return FloorPlan(Grid(occupied, (0.0, 0.0), 0.05))


def crate(x: float, y: float) -> WorldObject:
    return WorldObject(1, "crate", "box", "box", (x, y, 0.2), (0.2, 0.2, 0.4), 0.0)


def test_a_footprint_counts_and_not_the_box_around_it():
    corner = replace(crate(2.0, 1.2), size_m=(2.0, 1.0, 0.4), footprint_m=np.float32([[3.0, 1.2]]))
    field = geodesic.distance_field(room(), [corner], 0.2, 0.5)
    for x, expected in ((2.0, 0.5), (2.6, 0.0), (3.4, 0.0)):
        assert geodesic.value_at(room(), field, x, 1.2) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [(1.0, 1.2, 1.9), (3.8, 1.2, 0.0), (0.1, 1.2, math.inf), (9, 9, math.inf)],
)
def test_the_field_holds_distances_to_the_success_radius(x, y, expected):
    field = geodesic.distance_field(room(), [crate(4.0, 1.2)], 0.2, 1.0)
    assert geodesic.value_at(room(), field, x, y) == pytest.approx(expected, abs=0.06)
