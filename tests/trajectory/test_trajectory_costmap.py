"""Occupancy to weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.trajectory.costmap import UNIT, from_occupancy, from_weights


def twin(cells, resolution_m, clearance_m, near_m, near_cost, unknown_cost):
    """Exact distances, cell by cell."""
    out = np.zeros(cells.shape)
    closed = np.argwhere(cells >= 50)
    for r, c in np.ndindex(cells.shape):
        d = math.inf
        if len(closed):
            d = np.hypot(*(closed - (r, c)).T).min() * resolution_m
        if d == 0 or d < clearance_m or (cells[r, c] < 0 and unknown_cost is None):
            continue
        base = 1.0 if cells[r, c] >= 0 else unknown_cost
        near = near_cost * min(max(1 - (d - clearance_m) / near_m, 0.0), 1.0) ** 2
        out[r, c] = min(max((base + near) * UNIT, 1), 255)
    return out


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.02]),
    st.sampled_from([None, 0.5, 3.0, 40.0]),
    st.sampled_from([0.0, 0.16]),
)
def test_weights_agree_with_the_twin(seed, share, unknown_cost, clearance_m):
    rng = np.random.default_rng(seed)
    cells = rng.choice([-1, 0], (17, 23)).astype(np.int8)
    cells[rng.random(cells.shape) < share] = 100
    grid = Grid(cells, (0.0, 0.0), 0.1)
    near = {"near_m": 0.4, "near_cost": 4.0, "unknown_cost": unknown_cost}
    got = from_occupancy(grid, clearance_m=clearance_m, **near).weight[1:-1, 1:-1]
    wanted = twin(cells, 0.1, clearance_m, 0.4, 4.0, unknown_cost)
    assert ((got == 0) == (wanted == 0)).all()
    # The 5x5 chamfer distance is off by up to 2 %, and the table steps a sixteenth of a cell.
    assert np.abs(got - wanted).max() <= 0.1 * 4.0 * UNIT


def test_empty_map_has_only_its_border():
    costmap = from_occupancy(Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.05))
    assert costmap.weight.shape == (2, 2)
    assert not costmap.weight.any()
    assert costmap.cell_of(0.0, 0.0) is None


def test_occupied_is_closed_and_free_is_a_unit():
    cells = np.zeros((40, 40), np.int8)
    cells[0, 0], cells[39, 39] = 100, -1
    costmap = from_occupancy(Grid(cells, (0.0, 0.0), 0.05), near_m=0.2, unknown_cost=3.0)
    assert costmap.weight[1, 1] == 0
    assert costmap.weight[20, 20] == UNIT
    assert costmap.weight[40, 40] == 3 * UNIT
    assert costmap.min_weight == UNIT
    beside = costmap.weight[1, 2:8].astype(int)
    assert (np.diff(beside) <= 0).all()
    assert beside[0] > UNIT


@pytest.mark.parametrize(
    ("weights", "least", "h_weight"),
    [
        ([[0]], 1, 1),
        ([[16]], 16, 16),
        ([[0, 16, 48]], 16, 16),
        ([[1, 10, 10]], 1, 0),
        ([[255, 255]], 255, 255),
    ],
)
def test_the_heuristic_is_dropped_if_it_would_not_help(weights, least, h_weight):
    costmap = from_weights(Grid(np.array(weights, np.uint8), (0.0, 0.0), 1.0))
    assert (costmap.min_weight, costmap.h_weight) == (least, h_weight)


@pytest.mark.parametrize(
    ("x_m", "y_m"), [(-0.01, 0.5), (1.0, 0.5), (0.5, 1.0), (math.nan, 0.5), (0.5, math.inf)]
)
def test_outside_is_not_free(x_m, y_m):
    costmap = from_weights(Grid(np.ones((10, 10), np.uint8), (0.0, 0.0), 0.1))
    assert not costmap.is_free(x_m, y_m)


@pytest.mark.parametrize("cells", [np.zeros(4, np.int8), np.zeros((2, 2), np.float32)])
def test_an_invalid_grid_is_refused(cells):
    with pytest.raises(ValueError, match="expected"):
        from_occupancy(Grid(cells, (0.0, 0.0), 0.05))


def test_too_long_a_side_is_refused():
    with pytest.raises(ValueError, match="cells a side"):
        from_weights(Grid(np.ones((1, 20000), np.uint8), (0.0, 0.0), 0.05))
