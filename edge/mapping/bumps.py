"""Obstacles that no sensor shows, but at which the robot was blocked: a sill, glass, a cable.

A *sill* is a low bar across the way, such as at the bottom of a door. A *bump* is one contact with
such an obstacle. It closes cells of the map for some time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from edge import config
from edge.geometry import SE2
from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping import layers as ly
from edge.mapping.update import MOST_FLOOR_UPDATES
from edge.mapping.window import Window

ROUNDING_CELLS = 2
"""Cells by which a gap may seem narrower, because an obstacle and the robot's place are rounded to
cells."""
_MAX_BUMPS = 64
# Two bumps at most this far apart may be one sill.
_SAME_SILL_M = 1.5
# They are one sill only if the robot drove across the line between them both times: the cosine of
# the angle between the line and the motion is at most this.
_MAX_COSINE = 0.7
# A sill is assumed to extend beyond two bumps by the distance between them, at most by this.
_MAX_EXTENSION_M = 1.0
MEMORY_S = 600.0
"""Time for which the map stays closed where an obstacle that no sensor shows stopped the robot."""
_MEMORY_NS = int(MEMORY_S * 1e9)
# A first touch may have been a passer-by, so it is kept only for this share of `MEMORY_S`.
_FIRST_TOUCH_SHARE = 0.2

Cell = tuple[int, int]
XY = tuple[float, float]


class _Bump(NamedTuple):
    """Cells that one bump has closed.

    Attributes:
        place_m: place where the robot's front was blocked, driving along `heading_rad`.
        heading_rad: direction of the robot's motion.
        half_m: half the robot's width.
        until_ns: time when the cells are opened.
        felt: cells that the front touched.
        guessed: cells of a sill between this bump and another; `open_all` does not keep them.
        again: True if the robot was blocked there before. Then sensors cannot open the cells.
    """

    place_m: XY
    heading_rad: float
    half_m: float
    until_ns: int
    felt: frozenset[Cell] = frozenset()
    guessed: frozenset[Cell] = frozenset()
    again: bool = False

    @property
    def cells(self) -> frozenset[Cell]:
        """All cells that the bump has closed."""
        return self.felt | self.guessed

    @property
    def across(self) -> XY:
        """Unit vector to the left of the direction of motion."""
        return -math.sin(self.heading_rad), math.cos(self.heading_rad)


class _Closed(NamedTuple):
    """A cell that bumps have closed.

    Attributes:
        raw: value of the layer `raw` before.
        top: value of the layer `top` before.
        bumps: number of bumps that close it.
    """

    raw: int
    top: int
    bumps: int


class ContactObstacles:
    """World cells that are closed because the robot was blocked there.

    A bump closes the cells that the robot's front touched, as wide as the robot. Two bumps along
    one line form a sill. The cells between the two and beyond them are closed as well. No cell is
    closed at a known obstacle, or so near to the robot's trail that the way back would be blocked.

    A bump opens if the robot stands there, if the sensors see floor there, after a fifth of
    `MEMORY_S`, or by `open_all`. If the robot is then blocked there again, the sensors cannot see
    the obstacle: the bump stays for all of `MEMORY_S`.
    """

    def __init__(
        self,
        layers: ly.Layers,
        window: Window,
        config: config.MappingConfig,
        write: Callable[[int, int, int, int], None],
    ) -> None:
        self._layers, self._window, self._write = layers, window, write
        # Cells this far from the trail leave its middle open: see `layers.on_trail`.
        body_cells = config.inflation_m / config.resolution_m - ROUNDING_CELLS
        self._trail_margin_cells = max(body_cells - 0.5, 0.0)
        # A bump this near to one that was opened is the same obstacle, which is still there.
        self._same_m = 2 * config.inflation_m + ROUNDING_CELLS * config.resolution_m
        self._bumps: list[_Bump] = []  # oldest first
        self._opened: list[_Bump] = []  # opened but perhaps still there, oldest first
        self._closed: dict[Cell, _Closed] = {}  # all cells that bumps have closed

    @property
    def closed_m(self) -> list[XY]:
        """Places where the robot was blocked and the map is closed, oldest first."""
        return [bump.place_m for bump in self._bumps]

    @property
    def known_m(self) -> list[XY]:
        """`closed_m`, and places that `open_all` opened and the robot has not stood on since."""
        return [bump.place_m for bump in (*self._opened, *self._bumps)]

    def close(self, pose: SE2, place_m: XY, radius_m: float, now_ns: int) -> bool:
        """Close the cells that the robot touched; return True if any cell was closed.

        No cell is closed outside the window or on the robot's own trail.
        """
        heading = math.atan2(place_m[1] - pose.y_m, place_m[0] - pose.x_m)
        # The new bump, and opened ones near it: the obstacle was not gone.
        to_close = [self._with_cells(_Bump(place_m, heading, radius_m, 0))]
        closed = to_close[0].felt
        while to_close:
            bump = to_close.pop()
            near = [b for b in self._opened if math.dist(b.place_m, bump.place_m) <= self._same_m]
            self._opened = [b for b in self._opened if b not in near]
            to_close += [b._replace(again=True) for b in near]
            same = [b for b in self._bumps if b.felt <= bump.felt]  # the new bump replaces these
            again = bump.again or bool(near) or any(b.again for b in same)
            memory_ns = _MEMORY_NS if again else int(_FIRST_TOUCH_SHARE * _MEMORY_NS)
            guessed = bump.guessed.union(*(b.guessed for b in same))
            # Open first: `_close` may open the oldest bump, which may be one of these.
            for b in same:
                self._open(b)
            self._close(bump._replace(until_ns=now_ns + memory_ns, guessed=guessed, again=again))
        return bool(closed)

    def expire(self, now_ns: int) -> None:
        """Open bumps that are old enough. A later touch there counts as a first one again."""
        if self._opened:
            self._opened = [b for b in self._opened if now_ns < b.until_ns]
        for bump in [b for b in self._bumps if now_ns >= b.until_ns]:
            self._open(bump)

    def open_seen_free(self) -> None:
        """Open bumps where the sensors see floor, except those that were touched again."""
        for bump in [b for b in self._bumps if not b.again and self._is_seen_free(b)]:
            self._reopen(bump)

    def open_all(self) -> bool:
        """Open all bumps to try them once more; return True if there was any."""
        any_closed = bool(self._bumps)
        while self._bumps:
            self._reopen(self._bumps[0])
        return any_closed

    def clear_under_robot(self, cell: Cell) -> None:
        """Open the bumps at the robot's world cell: nothing blocks the robot there."""
        if cell in self._closed:
            for bump in [b for b in self._bumps if cell in b.cells]:
                self._open(bump)
            self._write(*cell, ly.FREE, 0)
        if self._opened:
            self._opened = [b for b in self._opened if cell not in b.felt]

    def follow_window(self) -> None:
        """Drop cells that have left the window."""
        held = {cell for cell in self._closed if self._window.contains(*cell)}
        self._closed = {cell: self._closed[cell] for cell in held}
        kept = [b._replace(felt=b.felt & held, guessed=b.guessed & held) for b in self._bumps]
        self._bumps = [bump for bump in kept if bump.cells]

    def state_dict(self) -> Arrays:
        """Return all bumps, with those that were opened to be tried again.

        A row of `cell` is (bump, x, y, 1 if guessed). A row of `closed` is (x, y, raw, top) with
        the values before the cell was closed.
        """
        opened = self._opened[-_MAX_BUMPS:]
        all_bumps = (*opened, *self._bumps)
        # `guessed` is 0 for the cells in `felt` and 1 for those in `guessed`.
        cells = [
            (i, *cell, guessed)
            for i, bump in enumerate(all_bumps)
            for guessed, held in enumerate((bump.felt, bump.guessed))
            for cell in sorted(held)
        ]
        closed = [(*cell, was.raw, was.top) for cell, was in self._closed.items()]
        return {
            "place_m": np.array([bump.place_m for bump in all_bumps]).reshape(-1, 2),
            "heading_rad": np.array([bump.heading_rad for bump in all_bumps], np.float64),
            "half_m": np.array([bump.half_m for bump in all_bumps], np.float64),
            "until_ns": np.array([bump.until_ns for bump in all_bumps], np.int64),
            "opened": np.arange(len(all_bumps)) < len(opened),
            "again": np.array([bump.again for bump in all_bumps], bool),
            "cell": np.array(cells, np.int64).reshape(-1, 4),
            "closed": np.array(closed, np.int64).reshape(-1, 4),
        }

    def load_state_dict(self, state: Arrays, clock_shift_ns: int) -> None:
        """Restore a `state_dict`, in a map whose layers have these cells closed.

        `clock_shift_ns` is the difference between the current clock and that of the `state_dict`.
        """
        fields = ("place_m", "heading_rad", "half_m", "until_ns", "opened", "again")
        rows = {fields: 2 * _MAX_BUMPS, ("cell",): 1 << 16, ("closed",): 1 << 16}
        check_arrays(state, self.state_dict(), rows, {})
        cells, raw_top = state["cell"], state["closed"][:, 2:]
        # Columns 0 and 3 of `cell`: the bump's index, and 0 or 1.
        if ((cells[:, ::3] < 0) | (cells[:, ::3] >= (len(state["opened"]), 2))).any():
            raise ValueError("cell: a row names a bump that does not exist")
        if ((raw_top < 0) | (raw_top > 255)).any():
            raise ValueError("closed: a raw or top value is not from 0 to 255")
        self._opened, self._bumps = [], []
        n_closing: dict[Cell, int] = {}
        for at, heading, half, until_ns, opened, again, (felt, guessed) in zip(
            *(state[name] for name in fields), _by_bump(cells, len(state["opened"])), strict=True
        ):
            bump = _Bump(
                (float(at[0]), float(at[1])), float(heading), float(half),
                int(until_ns) + clock_shift_ns, felt, guessed, bool(again),
            )  # fmt: skip
            (self._opened if opened else self._bumps).append(bump)
            for cell in () if opened else bump.cells:
                n_closing[cell] = n_closing.get(cell, 0) + 1
        was = {(x, y): (raw, top) for x, y, raw, top in state["closed"].tolist()}
        self._closed = {c: _Closed(*was.get(c, (ly.FREE, 0)), n) for c, n in n_closing.items()}
        self.follow_window()

    def _with_cells(self, bump: _Bump) -> _Bump:
        """Return a bump with the cells that it closes, given the map and the other bumps."""
        (x, y), touched_m = bump.across, self._off_trail(bump)
        felt: set[Cell] = set()
        if touched_m is not None:
            felt.add(self._window.cell_of(*touched_m))
            felt.update(self._cells_on_line(touched_m, (x, y), bump.half_m))
            felt.update(self._cells_on_line(touched_m, (-x, -y), bump.half_m))
        guessed: set[Cell] = set()
        for other in self._bumps:
            guessed.update(self._between(bump, other))
        inside = {cell for cell in felt | guessed if self._window.contains(*cell)}
        return bump._replace(
            felt=frozenset(felt & inside), guessed=frozenset(guessed & inside - felt)
        )

    def _off_trail(self, bump: _Bump) -> XY | None:
        """Return the touched place, moved along the heading until it leaves the trail open.

        An obstacle on the trail itself is not closed, because the robot came through there.
        """
        step_m, (x, y) = self._window.resolution_m, bump.place_m
        for k in range(math.ceil(self._trail_margin_cells) + 1):
            at = (
                x + k * step_m * math.cos(bump.heading_rad),
                y + k * step_m * math.sin(bump.heading_rad),
            )
            if not self._near_trail(self._window.cell_of(*at)):
                return at
        return None

    def _near_trail(self, cell: Cell) -> bool:
        n = self._window.n
        return ly.near_trail(self._layers, cell[1] % n, cell[0] % n, self._trail_margin_cells)

    def _is_seen_free(self, bump: _Bump) -> bool:
        """Return True if most touched cells were floor, and nothing else, in the last updates."""
        top, n = self._layers.top, self._window.n
        seen = sum(top[y % n, x % n] >= MOST_FLOOR_UPDATES for x, y in bump.felt)
        return 2 * seen > len(bump.felt)

    def _between(self, a: _Bump, b: _Bump) -> Iterator[Cell]:
        """Yield the cells of the sill that two bumps form; none if they are two obstacles."""
        gap_m = math.dist(a.place_m, b.place_m)
        if not self._window.resolution_m <= gap_m <= _SAME_SILL_M:
            return
        # Unit vector from a to b.
        x, y = ((q - p) / gap_m for p, q in zip(a.place_m, b.place_m, strict=True))
        if any(
            abs(x * math.cos(bump.heading_rad) + y * math.sin(bump.heading_rad)) > _MAX_COSINE
            for bump in (a, b)
        ):
            return
        extension_m = min(gap_m, _MAX_EXTENSION_M)
        yield from self._cells_on_line(a.place_m, (x, y), gap_m)
        yield from self._cells_on_line(b.place_m, (-x, -y), gap_m)
        yield from self._cells_on_line(b.place_m, (x, y), b.half_m + extension_m)
        yield from self._cells_on_line(a.place_m, (-x, -y), a.half_m + extension_m)

    def _cells_on_line(self, start_m: XY, direction: XY, length_m: float) -> Iterator[Cell]:
        """Yield the cells on a line from a place, up to a known obstacle or the robot's trail."""
        res, n = self._window.resolution_m, self._window.n
        for k in range(1, math.floor(2.0 * length_m / res) + 1):  # steps of half a cell
            cell = self._window.cell_of(
                start_m[0] + 0.5 * k * res * direction[0], start_m[1] + 0.5 * k * res * direction[1]
            )
            is_obstacle = ly.OCCUPIED <= self._layers.raw[cell[1] % n, cell[0] % n] < ly.BUMPED
            if is_obstacle or self._near_trail(cell) or not self._window.contains(*cell):
                return
            yield cell

    def _close(self, bump: _Bump) -> None:
        """Close the cells of a bump; open the oldest bump if there are too many."""
        if not bump.felt:
            return
        for cell in bump.cells:
            before = self._closed.get(cell)
            if before is None:
                at = cell[1] % self._window.n, cell[0] % self._window.n
                before = _Closed(int(self._layers.raw[at]), int(self._layers.top[at]), 0)
                self._write(*cell, ly.BUMPED, 0)
            self._closed[cell] = before._replace(bumps=before.bumps + 1)
        self._bumps.append(bump)
        if len(self._bumps) > _MAX_BUMPS:
            self._open(self._bumps[0])

    def _reopen(self, bump: _Bump) -> None:
        """Open a bump that may still be there, and remember it until its time is over."""
        self._open(bump)
        self._opened.append(bump._replace(guessed=frozenset()))

    def _open(self, bump: _Bump) -> None:
        """Restore the cells that no other bump has closed."""
        self._bumps.remove(bump)
        for cell in bump.cells:
            before = self._closed[cell]
            if before.bumps > 1:
                self._closed[cell] = before._replace(bumps=before.bumps - 1)
            else:
                del self._closed[cell]
                self._write(*cell, before.raw, before.top)


def explained_by_obstacle(
    layers: ly.Layers, window: Window, beyond_m: float, pose: SE2, place_m: XY, radius_m: float
) -> bool:
    """Return True if a known obstacle explains why the robot at `pose` is blocked at a place.

    The obstacle must be on the line from the robot through the place, from `radius_m` before the
    place to `beyond_m` behind it. Only half the robot's width counts, because obstacles at its
    side, such as door jambs next to a sill, do not block it. Obstacles that touch the robot's front
    half count too, such as the edge of a table in a turn.
    """
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
    raw = layers.raw[y % n, x % n]
    in_path = (-radius_m <= along) & (along <= beyond_m) & (np.abs(across) <= 0.5 * radius_m)
    ahead_m = along + math.dist(place_m, (pose.x_m, pose.y_m))  # from the robot's centre
    touched = (ahead_m >= 0.0) & (np.hypot(ahead_m, across) <= radius_m + res)
    return bool(
        np.any(
            (raw >= ly.OCCUPIED)
            & (raw != ly.BUMPED)
            & (in_path | touched)
            & (ox <= x) & (x < ox + n) & (oy <= y) & (y < oy + n)
        )
    )  # fmt: skip


def _by_bump(cells: np.ndarray, n: int) -> list[tuple[frozenset[Cell], frozenset[Cell]]]:
    """Return (felt, guessed) of each of `n` bumps, from rows of `ContactObstacles.state_dict`."""
    sets: list[tuple[set[Cell], set[Cell]]] = [(set(), set()) for _ in range(n)]
    for i, x, y, guessed in cells.tolist():
        sets[i][guessed].add((x, y))  # `guessed` is 0 or 1
    return [(frozenset(felt), frozenset(guessed)) for felt, guessed in sets]
