"""The value map: costs as the paper orders them, closed if the robot does not fit."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.tasks.scene.value_map import (
    BRIDGE,
    BRIDGE_M,
    CLOSED,
    DRIVABLE,
    HIGH,
    TUBE,
    PathMargins,
    value_map,
)

LINE = np.array([[0.5, 1.2], [3.0, 1.2]])
BODY = PathMargins(clearance_m=0.25, tube_m=0.4)


def grids(shape: tuple[int, int] = (30, 40), resolution_m: float = 0.1) -> tuple[Grid, Grid]:
    """Free cells with region 1 in the lower half and region 2 in the upper."""
    regions = np.ones(shape, np.uint8)
    regions[shape[0] // 2 :] = 2
    grid = Grid(np.zeros(shape, np.int8), (0.0, 0.0), resolution_m)
    return grid, replace(grid, cells=regions)


def weights(occupancy: Grid, regions: Grid, drivable=(1,), coarse_m=LINE, body=BODY) -> np.ndarray:
    return value_map(occupancy, regions, drivable, coarse_m, body).grid.cells


def twin(
    occupancy: Grid, regions: Grid, drivable, coarse_m: np.ndarray, body: PathMargins
) -> np.ndarray:
    """Cell by cell; NaN where a cell's middle is within half a cell of the tube's rim."""
    cells, out = occupancy.cells, np.full(occupancy.cells.shape, float(HIGH))
    closed, seen = np.argwhere(cells >= 50), np.argwhere((cells == 0) | (regions.cells > 0))
    for r, c in np.ndindex(cells.shape):
        x_m, y_m = occupancy.centres_m(np.array(r), np.array(c))
        if regions.cells[r, c] in drivable:
            away = [to_line_m((x_m, y_m), *leg) for leg in pairwise(coarse_m)]
            rim = min(away, default=math.inf) - body.tube_m
            out[r, c] = TUBE if rim < 0 else DRIVABLE
            if abs(rim) < 0.75 * occupancy.resolution_m:
                out[r, c] = math.nan
        gap_m = np.maximum(np.abs(closed - (r, c)) - 0.5, 0.0) * occupancy.resolution_m
        near_m = np.hypot(*gap_m.T).min() if len(closed) else math.inf
        unseen = not (np.hypot(*(seen - (r, c)).T) <= int(BRIDGE_M / occupancy.resolution_m)).any()
        if cells[r, c] < 0 and not regions.cells[r, c]:
            out[r, c] = BRIDGE
        if unseen or cells[r, c] >= 50 or near_m < body.clearance_m:
            out[r, c] = CLOSED
    return out


def to_line_m(point, start, end) -> float:
    along = np.subtract(end, start)
    share = np.dot(np.subtract(point, start), along) / max(float(along @ along), 1e-12)
    return math.dist(point, start + np.clip(share, 0.0, 1.0) * along)


def test_an_empty_map_is_an_empty_map():
    grid = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.1)
    costmap = value_map(grid, replace(grid, cells=np.zeros((0, 0), np.uint8)), {1}, LINE, BODY)
    assert costmap.grid.cells.shape == (0, 0)


@pytest.mark.parametrize(
    ("change", "cell", "expected"),
    [
        ({}, (12, 20), TUBE),
        ({}, (5, 20), DRIVABLE),
        # The tube does not lower unchosen cells: row 15 is 0.35 m from the line.
        ({}, (15, 20), HIGH),
        ({"drivable": (1, 2)}, (15, 20), TUBE),
        ({"drivable": ()}, (12, 20), HIGH),
        ({"coarse_m": np.empty((0, 2))}, (12, 20), DRIVABLE),
        ({"coarse_m": LINE[:1]}, (12, 5), TUBE),
        ({"coarse_m": LINE[:1]}, (12, 20), DRIVABLE),
        # Far outside, and through the map.
        ({"coarse_m": np.array([[-1e9, 1.2], [1e9, 1.2]])}, (2, 20), DRIVABLE),
    ],
)
def test_costs_of_free_ground(change, cell, expected):
    assert weights(*grids(), **change)[cell] == expected


@pytest.mark.parametrize(
    ("value", "cell", "expected"),
    [
        (100, (5, 20), CLOSED),
        (100, (5, 22), CLOSED),
        (100, (3, 22), CLOSED),
        (100, (2, 22), DRIVABLE),
        (100, (5, 23), DRIVABLE),
        # Between the rings of a LiDAR, and outside regions.
        (-1, (5, 20), DRIVABLE),
        (-1, (20, 20), CLOSED),
        (-1, (16, 20), BRIDGE),
    ],
)
def test_weights_of_occupied_and_unseen_cells(value, cell, expected):
    occupancy, regions = grids()
    occupancy.cells[5, 20] = value
    if value < 0:
        occupancy.cells[16:25, 16:25], regions.cells[16:25, 16:25] = value, 0
    assert weights(occupancy, regions)[cell] == expected


def test_the_order_is_the_papers():
    assert CLOSED < TUBE < DRIVABLE < BRIDGE < HIGH
    assert math.pi / 2 < DRIVABLE / TUBE


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.03]),
    st.sampled_from([0.0, 0.1, 0.27]),
    st.sampled_from([0.3, 0.8]),
)
def test_it_agrees_with_the_twin(seed, share, clearance_m, tube_m):
    rng = np.random.default_rng(seed)
    cells = rng.choice(np.array([-1, 0, 0, 0], np.int8), (19, 23))
    cells[rng.random(cells.shape) < share] = 100
    occupancy = Grid(cells, (-1.0, 0.5), 0.1)
    regions = replace(occupancy, cells=rng.integers(0, 4, cells.shape).astype(np.uint8))
    occupancy.cells[4:, 9:], regions.cells[4:, 9:] = -1, 0  # wider than a bridge
    coarse_m = rng.uniform([-1.2, 0.3], [1.4, 2.6], (4, 2))
    body = PathMargins(clearance_m, tube_m)
    wanted = twin(occupancy, regions, {1, 3}, coarse_m, body)
    got = weights(occupancy, regions, {1, 3}, coarse_m, body)
    sure = np.isfinite(wanted)
    np.testing.assert_array_equal(got[sure], wanted[sure])
    assert np.isin(got[~sure], (TUBE, DRIVABLE)).all()
