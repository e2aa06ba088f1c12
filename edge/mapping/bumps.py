"""Where the robot was held up by something that no sensor shows: a sill, glass, a cable."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from edge import config
from edge.geometry import SE2
from edge.mapping import layers as ly
from edge.mapping.window import Window

ROUNDING_CELLS = 2
"""Rounding an obstacle and the robot's place to cells takes up to this much off the gap between."""
_MOST = 64

Cell = tuple[int, int]


class _Bump(NamedTuple):
    """A cell that is closed by hand.

    Attributes:
        until_ns: when it opens.
        raw, top: what the layers of these names held before.
    """

    until_ns: int
    raw: int
    top: int


class Bumps:
    """World cells that are closed by hand: sensors see through them, so no ray clears them.

    One opens after `bump_memory_s`, when the robot stands there, or by `open_all`.

    Args:
        write: sets one world cell to a state, with the height of its obstacle.
    """

    def __init__(
        self,
        layers: ly.Layers,
        window: Window,
        config: config.Mapping,
        write: Callable[[int, int, int, int], None],
    ) -> None:
        self._layers, self._window, self._write = layers, window, write
        self._memory_ns = int(config.bump_memory_s * 1e9)
        self._inflation_m = config.inflation_m
        # A place within this of one that was opened is the same sill, and still there.
        self._same_cells = 2 * config.inflation_m / config.resolution_m + ROUNDING_CELLS
        self._closed: dict[Cell, _Bump] = {}  # oldest first
        self._opened: dict[Cell, int] = {}  # by `open_all`; until when remembered

    @property
    def closed_m(self) -> list[tuple[float, float]]:
        """Centres of the cells that are closed, oldest first."""
        return [self._window.centre_m(cell) for cell in self._closed]

    @property
    def known_m(self) -> list[tuple[float, float]]:
        """Like `closed_m`, with those that `open_all` opened and the robot did not stand on."""
        return [self._window.centre_m(cell) for cell in (*self._opened, *self._closed)]

    def close(self, x_m: float, y_m: float, now_ns: int) -> None:
        """Close the cell of a place; outside the window nothing happens.

        Args:
            now_ns: of the clock that `expire` is told.
        """
        until_ns = now_ns + self._memory_ns
        found = [self._window.cell_of(x_m, y_m)]
        while found:
            cell = found.pop()
            beside = [c for c in self._opened if math.dist(c, cell) <= self._same_cells]
            for c in beside:
                del self._opened[c]
            found += beside
            if self._window.holds(*cell):
                self._close(cell, until_ns)

    def expire(self, now_ns: int) -> None:
        """Open and forget what was closed long enough ago."""
        while self._opened:
            cell, until_ns = next(iter(self._opened.items()))
            if now_ns < until_ns:
                break
            del self._opened[cell]
        while self._closed:
            cell, bump = next(iter(self._closed.items()))
            if now_ns < bump.until_ns:
                break
            self._open(cell)

    def open_all(self) -> bool:
        """Open all that is closed, to be tried once more; whether there was any."""
        self._opened.update((cell, bump.until_ns) for cell, bump in self._closed.items())
        any_closed = bool(self._closed)
        while self._closed:
            self._open(next(iter(self._closed)))
        return any_closed

    def stand_on(self, cell: Cell) -> None:
        """The robot is on this world cell, so nothing holds it up there."""
        if self._closed.pop(cell, None) is not None:
            self._write(*cell, ly.FREE, 0)
        self._opened.pop(cell, None)

    def follow_window(self) -> None:
        """Forget what the window has left."""
        self._closed = {c: bump for c, bump in self._closed.items() if self._window.holds(*c)}

    def explained(self, pose: SE2, place_m: tuple[float, float], radius_m: float) -> bool:
        """Whether an obstacle that was seen explains why a robot at `pose` is held up at a place.

        It does where it stands on the line from the robot through the place: from `radius_m`
        before the place to the inflation behind it. Half the robot's width counts: what is
        beside it, as the jambs of a door are beside its sill, does not hold it up.

        Args:
            radius_m: the robot's.
        """
        window, beyond_m = self._window, self._inflation_m
        if not window.placed:
            return False
        res, n, (ox, oy) = window.resolution_m, window.n, window.origin
        reach = math.ceil((max(radius_m, beyond_m) + radius_m) / res)
        offset = np.arange(-reach, reach + 1)
        at_x, at_y = window.cell_of(*place_m)
        x, y = at_x + offset[None, :], at_y + offset[:, None]
        dx, dy = (x + 0.5) * res - place_m[0], (y + 0.5) * res - place_m[1]
        heading = math.atan2(place_m[1] - pose.y_m, place_m[0] - pose.x_m)
        c, s = math.cos(heading), math.sin(heading)
        along, across = dx * c + dy * s, dy * c - dx * s
        raw = self._layers.raw[y % n, x % n]
        return bool(
            np.any(
                (raw >= ly.OCCUPIED)
                & (raw != ly.BUMPED)
                & (-radius_m <= along) & (along <= beyond_m)
                & (np.abs(across) <= 0.5 * radius_m)
                & (ox <= x) & (x < ox + n) & (oy <= y) & (y < oy + n)
            )
        )  # fmt: skip

    def _close(self, cell: Cell, until_ns: int) -> None:
        before = self._closed.pop(cell, None)
        if before is None:
            at = cell[1] % self._window.n, cell[0] % self._window.n
            before = _Bump(0, int(self._layers.raw[at]), int(self._layers.top[at]))
            self._write(*cell, ly.BUMPED, 0)
        self._closed[cell] = before._replace(until_ns=until_ns)
        if len(self._closed) > _MOST:
            self._open(next(iter(self._closed)))

    def _open(self, cell: Cell) -> None:
        """Give a closed cell back the state that it had."""
        bump = self._closed.pop(cell)
        self._write(*cell, bump.raw, bump.top)
