"""Which part of the world the map's torus holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edge.geometry import Grid

TILE = 64
"""Cells on a side of a tile; the window moves by whole ones."""


class Window:
    """A square of n x n world cells; world cell c of an axis is stored at c mod n.

    World cells count from `map`'s origin: cell (x, y) spans [x, x + 1) x [y, y + 1) times
    `resolution_m`. Whoever keeps a layer reads the window; only the map moves it.

    Attributes:
        origin: world cell (x, y) of the lower-left corner.
        placed: whether the window has its place; the first sensor decides it.
        written: (n / TILE, n / TILE) bool by storage tile: a layer that lasts was written there.
            Whoever writes sets it; who copies what was written clears it.
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
        """The world cell (x, y) of a point, in the window or not."""
        return math.floor(x_m / self.resolution_m), math.floor(y_m / self.resolution_m)

    def centre_m(self, cell: tuple[int, int]) -> tuple[float, float]:
        """The centre of a world cell."""
        return (cell[0] + 0.5) * self.resolution_m, (cell[1] + 0.5) * self.resolution_m

    def holds(self, x: int, y: int) -> bool:
        """Whether a world cell lies in the window."""
        (ox, oy), n = self.origin, self.n
        return self.placed and ox <= x < ox + n and oy <= y < oy + n

    def copy_of(self, plane: Callable[[], np.ndarray]) -> Grid:
        """What is written of a layer, as it lies in the world; costs with the map's size.

        Another thread may call it while the window moves: then the layer is read again.

        Args:
            plane: gives an (m, m) copy of the layer by its storage cells, 0 where nothing is
                written; m divides the window's n.
        """
        while True:
            (ox, oy), cells = self.origin, plane()
            step = self.n // len(cells)
            cell_m = step * self.resolution_m
            unrolled = np.roll(cells, (-(oy // step), -(ox // step)), (0, 1))
            if self.origin == (ox, oy):
                break
        rows, columns = (np.flatnonzero(unrolled.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return Grid(np.zeros((0, 0), cells.dtype), (0.0, 0.0), cell_m)
        y, x = int(rows[0]), int(columns[0])
        written = unrolled[y : rows[-1] + 1, x : columns[-1] + 1].copy()
        corner_m = ox * self.resolution_m + x * cell_m, oy * self.resolution_m + y * cell_m
        return Grid(written, corner_m, cell_m)

    def wrote(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Note that layers were written in a half-open rectangle of world cells."""
        (ox, oy), n, m = self.origin, self.n, len(self.written)
        x0, y0, x1, y1 = max(x0, ox), max(y0, oy), min(x1, ox + n), min(y1, oy + n)
        if x0 >= x1 or y0 >= y1:
            return
        rows, columns = _tiles(y0, y1, m), _tiles(x0, x1, m)
        for row in rows:
            for column in columns:
                self.written[row, column] = True


def _tiles(start: int, end: int, m: int) -> tuple[slice, ...]:
    """Storage tiles along one axis that hold the cells of [start, end), in one run or two."""
    first, last = start // TILE, (end - 1) // TILE + 1
    if last - first >= m:
        return (slice(0, m),)
    first, last = first % m, (last - 1) % m + 1
    return (slice(first, last),) if first < last else (slice(first, m), slice(0, last))
