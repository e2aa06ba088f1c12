"""Which part of the world the map's torus holds."""

from __future__ import annotations

import math


class Window:
    """A square of n x n world cells; world cell c of an axis is stored at c mod n.

    World cells count from `map`'s origin: cell (x, y) spans [x, x + 1) x [y, y + 1) times
    `resolution_m`. Whoever keeps a layer reads the window; only the map moves it.

    Attributes:
        origin: world cell (x, y) of the lower-left corner.
        placed: whether the window has its place; the first sensor decides it.
    """

    __slots__ = ("n", "origin", "placed", "resolution_m")

    def __init__(self, n: int, resolution_m: float) -> None:
        self.n = n
        self.resolution_m = resolution_m
        self.origin = (0, 0)
        self.placed = False

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
