"""Image of an occupancy grid for reports: its known part, and the colours of its cells."""

from __future__ import annotations

import numpy as np

from edge.geometry import Grid
from edge.lab.report import palette

MAX_SIDE_PX = 1600  # longest side of the image; larger maps are downsampled
Box = tuple[float, float, float, float]
"""(x_min, x_max, y_min, y_max) in metres of `map`, like matplotlib's `extent`."""


def crop(grid: Grid) -> Grid | None:
    """Return the smallest part of the map with every known cell; None if nothing is known."""
    known = grid.cells >= 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return None
    y, x = int(rows[0]), int(columns[0])
    cells = grid.cells[y : rows[-1] + 1, x : columns[-1] + 1]
    return Grid(cells, tuple(grid.to_metres((x, y)).tolist()), grid.resolution_m)


def colour(cells: np.ndarray) -> np.ndarray:
    """Return (h, w, 3) uint8 colours of cells: unknown < 0, free 0, inflated 1-99, occupied."""
    kinds = (palette.UNKNOWN, palette.FREE, palette.INFLATED, palette.OCCUPIED)
    table = np.array([_rgb(kind) for kind in kinds])
    # Index into `kinds`: up to -1 it is 0, 0 gives 1, 1 to 99 give 2, and larger values 3.
    return table[np.searchsorted((-1, 0, 99), cells)]


def _rgb(hex_colour: str) -> np.ndarray:
    return np.frombuffer(bytes.fromhex(hex_colour[1:]), dtype=np.uint8)
