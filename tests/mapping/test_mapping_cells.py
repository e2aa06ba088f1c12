"""Cells of the map: what is written, inflated and reported as changed."""

from __future__ import annotations

import numpy as np
from mapping_twins import SMALL

from edge.mapping import layers as ly
from edge.mapping.cells import MapCells


def test_no_cell_has_changed_at_first():
    assert MapCells(SMALL, 10).take_changed() is None


def test_a_written_cell_is_reported_once_with_its_inflation():
    cells = MapCells(SMALL, 10)
    cells.window.placed = True
    radius = len(cells.disc) // 2
    cells.write(40, 30, ly.OCCUPIED)
    assert cells.take_changed() == (40 - radius, 30 - radius, 41 + radius, 31 + radius)
    assert cells.take_changed() is None
    assert cells.layers.near[30, 40 + radius] == 1
    cells.write(40, 30, ly.UNSEEN)
    assert not any(np.any(layer) for layer in cells.layers)


def test_cells_that_leave_the_window_are_cleared_with_their_inflation():
    cells = MapCells(SMALL, 10)
    cells.window.placed = True
    cells.write(63, 30, ly.OCCUPIED)  # its inflation reaches into the next tile
    cells.roll(0, 64, np.zeros(1, np.bool_))
    assert cells.window.origin == (64, 0)
    assert not any(np.any(layer) for layer in cells.layers)
