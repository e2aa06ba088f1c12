"""Straightened paths stay open, cheap and evenly spaced."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.trajectory import astar, kernels, smoothing
from edge.trajectory.costmap import from_weights


def line_twin(weight: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> float:
    """Weight along a line by fine sampling; -1 when a sample is in a closed cell."""
    n = 20000
    t = (np.arange(n) + 0.5) / n
    w = weight[(y0 + t * (y1 - y0)).astype(int), (x0 + t * (x1 - x0)).astype(int)]
    return -1.0 if (w == 0).any() else float(w.mean() * math.hypot(x1 - x0, y1 - y0))


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1]))
def test_line_cost_agrees_with_the_twin(seed, share):
    rng = np.random.default_rng(seed)
    weight = np.pad(rng.integers(1, 30, (12, 9)).astype(np.uint8), 1)
    weight[rng.random(weight.shape) < share] = 0
    x0, x1 = rng.uniform(1, 10, 2)
    y0, y1 = rng.uniform(1, 13, 2)
    got, wanted = kernels.line_cost(weight, x0, y0, x1, y1), line_twin(weight, x0, y0, x1, y1)
    if wanted < 0:
        assert got == -1.0
    elif got >= 0:  # a sliver of a closed cell can fall between the twin's samples
        assert got == pytest.approx(wanted, rel=5e-3, abs=0.05)


@pytest.mark.parametrize(
    ("line", "cost"),
    [
        ((1.5, 1.5, 1.5, 1.5), 0.0),
        ((1.5, 1.5, 4.5, 1.5), 3.0),
        ((4.5, 1.5, 1.5, 1.5), 3.0),
        ((1.5, 1.5, 1.5, 4.5), 3.0),
        ((1.5, 1.5, 4.5, 4.5), 3 * math.sqrt(2)),
        ((4.5, 4.5, 1.5, 1.5), 3 * math.sqrt(2)),
        ((1.0, 1.5, 3.0, 1.5), 2.0),
        ((1.5, 1.5, 7.5, 1.5), -1.0),
        ((math.nan, 1.5, 2.5, 1.5), -1.0),
        ((1.5, 1.5, math.nan, 1.5), -1.0),
        ((1.5, 1.5, 2.5, math.inf), -1.0),
    ],
)
def test_lines_on_open_ground(line, cost):
    weight = np.pad(np.ones((5, 5), np.uint8), 1)
    assert kernels.line_cost(weight, *line) == pytest.approx(cost)


def test_a_diagonal_line_needs_both_corner_cells():
    weight = np.pad(np.ones((3, 3), np.uint8), 1)
    weight[1, 2] = 0
    assert kernels.line_cost(weight, 1.5, 1.5, 2.5, 2.5) == -1.0
    assert kernels.line_cost(weight, 2.5, 2.5, 1.5, 1.5) == -1.0


@given(st.integers(0, 2**32 - 1))
def test_smooth_path_costs_no_more_and_stays_open(seed):
    rng = np.random.default_rng(seed)
    weights = rng.integers(16, 60, (40, 40)).astype(np.uint8)
    weights[rng.random(weights.shape) < 0.15] = 0
    weights[2, 2] = weights[37, 37] = 16
    costmap = from_weights(Grid(weights, (-1.0, 0.5), 0.05))
    start, goal = costmap.metres_of(np.array([[3.5, 3.5], [38.5, 38.5]]))
    plan = astar.plan(costmap, tuple(start), tuple(goal))
    if not plan.ok:
        return
    path = smoothing.smooth(costmap, plan.path_m, 0.05)
    before = smoothing.polyline_cost_m(costmap, plan.path_m)
    assert smoothing.polyline_cost_m(costmap, path) <= before * 1.01
    assert path[0] == pytest.approx(start)
    assert path[-1] == pytest.approx(goal)
    assert np.hypot(*np.diff(path, axis=0).T).max() <= 0.05 + 1e-9


def test_open_ground_becomes_a_straight_line():
    costmap = from_weights(Grid(np.full((60, 60), 16, np.uint8), (0.0, 0.0), 0.05))
    plan = astar.plan(costmap, (0.1, 0.2), (2.7, 1.4))
    path = smoothing.smooth(costmap, plan.path_m, 0.1)
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert length == pytest.approx(math.hypot(2.6, 1.2), rel=0.01)


@pytest.mark.parametrize(
    ("path", "points"),
    [
        ([], 0),
        ([[1, 1]], 1),
        ([[0, 0], [0, 0]], 1),
        ([[0, 0], [1, 0]], 11),
        ([[0, 0], [0, 0.1]], 2),
    ],
)
def test_resample(path, points):
    path = np.array(path, float).reshape(-1, 2)
    out = smoothing.resample(path, 0.1) if len(path) > 1 else path
    assert len(out) == points
