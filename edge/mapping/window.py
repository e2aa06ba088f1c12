"""Window: the square of the world that the map's layers hold, and how they store its cells."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edge.geometry import Grid

TILE = 64
"""Cells on a side of a tile; the window moves by complete tiles."""


class Window:
    """A square of n x n world cells; world cell c of an axis is stored at c mod n (a torus).

    World cells count from the origin of `map`: cell (x, y) spans [x, x + 1) x [y, y + 1) times
    `resolution_m`. Layers read the window; only the map moves it.

    Attributes:
        n: cells on a side.
        resolution_m: side of a cell.
        origin: world cell (x, y) of the lower-left corner.
        placed: True once the window has its place; the first sensor data set it.
        written: (n / TILE, n / TILE) bool by storage tile: True if a layer of the checkpoint was
            written there since the last copy. Writers of layers set it; `TileCopier` clears it.
    """

    __slots__ = ("n", "origin", "placed", "resolution_m", "written")

    def __init__(self, n: int, resolution_m: float) -> None:
        self.n = n
        self.resolution_m = resolution_m
        self.origin = (0, 0)
        self.placed = False
        self.written = np.zeros((n // TILE, n // TILE), np.bool_)

    @property
    def shift(self) -> tuple[int, int]:
        """Storage cell (x, y) of the lower-left corner."""
        return self.origin[0] % self.n, self.origin[1] % self.n

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the world cell (x, y) of a point, inside the window or not."""
        return math.floor(x_m / self.resolution_m), math.floor(y_m / self.resolution_m)

    def contains(self, x: int, y: int) -> bool:
        """Return True if a world cell is in the window."""
        (ox, oy), n = self.origin, self.n
        return self.placed and ox <= x < ox + n and oy <= y < oy + n

    def leaving(self, axis: int, by: int, bits: int) -> tuple[slice | np.ndarray, ...]:
        """Return the storage index of the strip that leaves when the window moves by `by` cells.

        It is of a layer with squares of 2**`bits` map cells; `axis` is 0 for x and 1 for y.
        """
        gone = min(abs(by), self.n)
        start = self.origin[axis] + (0 if by > 0 else self.n - gone)
        strip = np.arange(start >> bits, (start + gone) >> bits) % (self.n >> bits)
        return (slice(None), strip) if axis == 0 else (strip,)

    def copy_of(self, plane: Callable[[], np.ndarray]) -> Grid:
        """Return the written part of a layer as a grid in `map`.

        The cost grows with the map's size. Another thread may call it. If the window moves during
        the copy, the layer is read again.

        Args:
            plane: returns an (m, m) copy of the layer by storage cells, 0 = not written; m divides
                n.
        """
        while True:
            (ox, oy), cells = self.origin, plane()
            factor = self.n // len(cells)
            cell_m = factor * self.resolution_m
            unrolled = np.roll(cells, (-(oy // factor), -(ox // factor)), (0, 1))
            if self.origin == (ox, oy):
                break
        rows, columns = (np.flatnonzero(unrolled.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return Grid(np.zeros((0, 0), cells.dtype), (0.0, 0.0), cell_m)
        y, x = int(rows[0]), int(columns[0])
        written = unrolled[y : rows[-1] + 1, x : columns[-1] + 1].copy()
        corner_m = ox * self.resolution_m + x * cell_m, oy * self.resolution_m + y * cell_m
        return Grid(written, corner_m, cell_m)

    def mark_written(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Mark a half-open rectangle of world cells as written."""
        (ox, oy), n, m = self.origin, self.n, len(self.written)
        x0, y0, x1, y1 = max(x0, ox), max(y0, oy), min(x1, ox + n), min(y1, oy + n)
        if x0 >= x1 or y0 >= y1:
            return
        rows, columns = _tiles(y0, y1, m), _tiles(x0, x1, m)
        for row in rows:
            for column in columns:
                self.written[row, column] = True


def _tiles(start: int, end: int, m: int) -> tuple[slice, ...]:
    """Return the storage tiles along one axis with the cells [start, end), in one run or two."""
    first, last = start // TILE, (end - 1) // TILE + 1
    if last - first >= m:
        return (slice(0, m),)
    first, last = first % m, (last - 1) % m + 1
    return (slice(first, last),) if first < last else (slice(first, m), slice(0, last))
