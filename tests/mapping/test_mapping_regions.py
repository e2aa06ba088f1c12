"""The map cut into regions at its narrow places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping_twins import basins

from edge.mapping import regions
from edge.mapping.layers import FREE, OCCUPIED, make_layers
from edge.mapping.regions import OPEN, UNKNOWN, WALL
from edge.mapping.window import Window

CELL_M = 0.1


def two_rooms(gap_cells: int) -> np.ndarray:
    """4 m × 4 m each, with a gap in the wall between."""
    cells = np.full((42, 83), OPEN, np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = WALL
    cells[:, 41] = WALL
    middle = 21 - gap_cells // 2
    cells[middle : middle + gap_cells, 41] = OPEN
    return cells


@pytest.mark.parametrize(
    ("cells", "n"),
    [
        (np.zeros((0, 0), np.uint8), 0),
        (np.zeros((5, 7), np.uint8), 0),
        (np.full((5, 7), WALL, np.uint8), 0),
        (np.full((5, 7), OPEN, np.uint8), 1),
        (two_rooms(0), 2),
        (two_rooms(9), 2),
        (two_rooms(19), 2),
        (two_rooms(30), 1),
        (two_rooms(40), 1),
    ],
)
def test_rooms_part_at_doors(cells, n):
    label, found = regions.segment_rooms(cells, CELL_M)
    assert found == n
    assert label.shape == cells.shape
    np.testing.assert_array_equal(label > 0, cells == OPEN)
    assert set(np.unique(label)) - {0} == set(range(1, n + 1))


def test_the_border_of_two_rooms_lies_in_the_door():
    label, _ = regions.segment_rooms(two_rooms(9), CELL_M)
    assert len(np.unique(label[1:-1, 1:40])) == len(np.unique(label[1:-1, 43:-1])) == 1
    border = regions.border_lengths(label, 2)
    np.testing.assert_array_equal(border, border.T)
    assert 9 <= border[1, 2] <= 13


def test_unknown_cells_do_not_divide_a_room():
    cells = np.full((40, 40), OPEN, np.uint8)
    cells[18:22, :15] = cells[18:22, 25:] = UNKNOWN
    label, n = regions.segment_rooms(cells, CELL_M)
    assert n == 1
    assert not label[cells == UNKNOWN].any()


@given(seed=st.integers(0, 2**31))
def test_basins_are_their_twins(seed):
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((12, 17)) < 0.2, WALL, OPEN).astype(np.uint8)
    cells[rng.random(cells.shape) < 0.1] = UNKNOWN
    apart = rng.uniform(0.0, 2.0, cells.shape).astype(np.float32)
    order = np.argsort(-apart, axis=None, kind="stable")
    label = np.zeros(cells.shape, np.int16)
    n = regions._basins(cells, apart, order, 1.1, 0.8, 6.0, label)
    expected = basins(cells, apart, order, 1.1, 0.8, 6.0)
    assert n == expected.max(initial=0)
    np.testing.assert_array_equal(label, expected)


@given(seed=st.integers(0, 2**31))
def test_the_survey_reads_the_torus(seed):
    """Coarse cells are walls where one of their cells is tall, open where one is known."""
    rng = np.random.default_rng(seed)
    window = Window(128, 0.05)
    window.origin, window.placed = tuple((64 * rng.integers(-3, 3, 2)).tolist()), True
    layers, n = make_layers(128), 128
    world = np.zeros((n, n), np.uint8)
    for _ in range(30):
        x, y = rng.integers(0, n, 2)
        tall, low = rng.random(2) < 0.5
        world[y, x] = WALL if tall and low else OPEN
        sy, sx = (y + window.origin[1]) % n, (x + window.origin[0]) % n
        layers.raw[sy, sx] = OCCUPIED if low else FREE
        layers.top[sy, sx] = 200 if tall else 20
        layers.known[sy, sx // 64] |= np.uint64(1) << np.uint64(sx % 64)
    grid = regions.coarse_grid(layers, window, 200, 0.1)
    assert grid.resolution_m == pytest.approx(0.1)
    x0 = round(grid.origin_xy_m[0] / 0.05) - window.origin[0]
    y0 = round(grid.origin_xy_m[1] / 0.05) - window.origin[1]
    h, w = grid.cells.shape
    got = np.zeros((n // 2, n // 2), np.uint8)
    got[y0 // 2 : y0 // 2 + h, x0 // 2 : x0 // 2 + w] = grid.cells
    np.testing.assert_array_equal(got, world.reshape(n // 2, 2, n // 2, 2).max((1, 3)))


@given(seed=st.integers(0, 2**31))
def test_regions_at_is_its_twin(seed):
    rng = np.random.default_rng(seed)
    label = np.where(rng.random((9, 14)) < 0.2, rng.integers(1, 4, (9, 14)), 0).astype(np.int16)
    xy = rng.uniform(-0.5, 2.0, (5, 3)).astype(np.float32)
    out = np.full(6, 9, np.int16)
    regions.regions_at(label, 0.1, -0.2, 0.1, xy, 5, 0.3, out)
    rows, cols = np.nonzero(label)
    for (x, y, _), found in zip(xy.astype(float), out, strict=False):
        row, col = np.floor((y - -0.2) / 0.1), np.floor((x - 0.1) / 0.1)
        apart = (rows - row) ** 2 + (cols - col) ** 2
        if (apart <= 9).any():
            best = apart == apart.min()
            assert found in label[rows[best], cols[best]]
        else:
            assert found == 0
    assert out[5] == 9
