"""Where the robot was held up by something that no sensor shows: a sill, glass, a cable."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from edge import config
from edge.geometry import SE2
from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping import layers as ly
from edge.mapping.update import SEEN_FREE
from edge.mapping.window import Window

ROUNDING_CELLS = 2
"""Rounding an obstacle and the robot's place to cells takes up to this much off the gap between."""
_MOST = 64
# Two bumps that lie no farther apart, on a line across the robot's way both times, are one sill's.
_SAME_SILL_M, _ACROSS = 1.5, 0.7
# A sill is taken to go on beyond two bumps by as much as they are apart, and no more than this.
_GOES_ON_M = 1.0
# A first touch may have been a passer-by: it is remembered for this part of `bump_memory_s`.
_FIRST = 0.2

Cell = tuple[int, int]
Place = tuple[float, float]


class _Bump(NamedTuple):
    """What one bump has closed.

    Attributes:
        place_m: where the robot's front was held up, driving along `heading_rad`.
        half_m: half the robot's width.
        until_ns: when it opens.
        felt: cells that the front touched.
        guessed: cells of the sill that this bump and another make out; not kept by `open_all`.
        again: the robot was held up there before, so what the sensors show there is not believed.
    """

    place_m: Place
    heading_rad: float
    half_m: float
    until_ns: int
    felt: frozenset[Cell] = frozenset()
    guessed: frozenset[Cell] = frozenset()
    again: bool = False

    @property
    def cells(self) -> frozenset[Cell]:
        return self.felt | self.guessed

    @property
    def across(self) -> Place:
        """Unit vector to the left of the way."""
        return -math.sin(self.heading_rad), math.cos(self.heading_rad)


class _Closed(NamedTuple):
    """A cell that is closed by hand.

    Attributes:
        raw, top: what the layers of these names held before.
        bumps: by how many bumps.
    """

    raw: int
    top: int
    bumps: int


class Bumps:
    """World cells that are closed because something held the robot up there.

    A bump closes what the robot's front touched, as wide as the robot. Two along one line make out
    a sill: it is closed between them, and beyond them as far as they are apart. No cell is closed
    where something stands, or so near to the robot's trail that the way back would be shut.

    A bump opens when the robot stands there, when the sensors see floor there, after a fifth of
    `bump_memory_s`, or by `open_all`. If the robot is then held up there again, the sensors do not
    show what is there: the bump stays for all of `bump_memory_s`.

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
        # What keeps away from the trail by this leaves its middle open: see `layers.on_trail`.
        body_cells = config.inflation_m / config.resolution_m - ROUNDING_CELLS
        self._clear_cells = max(body_cells - 0.5, 0.0)
        # A place within this of one that was opened is the same sill, and still there.
        self._same_m = 2 * config.inflation_m + ROUNDING_CELLS * config.resolution_m
        self._bumps: list[_Bump] = []  # oldest first
        self._opened: list[_Bump] = []  # by `open_all`, oldest first
        self._closed: dict[Cell, _Closed] = {}

    @property
    def closed_m(self) -> list[Place]:
        """Where the robot was held up and the map is closed, oldest first."""
        return [bump.place_m for bump in self._bumps]

    @property
    def known_m(self) -> list[Place]:
        """Like `closed_m`, with what `open_all` opened and the robot did not stand on."""
        return [bump.place_m for bump in (*self._opened, *self._bumps)]

    def close(self, pose: SE2, place_m: Place, radius_m: float, now_ns: int) -> bool:
        """Close what a robot touched; return whether anything was closed.

        Nothing is outside the window, nor on the robot's own trail.

        Args:
            pose: of the robot.
            place_m: where its front was held up.
            radius_m: the robot's.
            now_ns: of the clock that `expire` is told.
        """
        heading = math.atan2(place_m[1] - pose.y_m, place_m[0] - pose.x_m)
        found = [self._with_cells(_Bump(place_m, heading, radius_m, 0))]
        closed = found[0].felt
        while found:
            bump = found.pop()
            near = [b for b in self._opened if math.dist(b.place_m, bump.place_m) <= self._same_m]
            self._opened = [b for b in self._opened if b not in near]
            found += [b._replace(again=True) for b in near]
            same = [b for b in self._bumps if b.felt <= bump.felt]
            again = bump.again or bool(near) or any(b.again for b in same)
            lasts_ns = self._memory_ns if again else int(_FIRST * self._memory_ns)
            guessed = bump.guessed.union(*(b.guessed for b in same))
            self._close(bump._replace(until_ns=now_ns + lasts_ns, guessed=guessed, again=again))
            for b in same:
                self._open(b)
        return bool(closed)

    def expire(self, now_ns: int) -> None:
        """Open what was closed long enough ago. A second touch there is then a first one."""
        if self._opened:
            self._opened = [b for b in self._opened if now_ns < b.until_ns]
        for bump in [b for b in self._bumps if now_ns >= b.until_ns]:
            self._open(bump)

    def open_seen_free(self) -> None:
        """Open what the sensors have seen to be floor, but for what was touched again."""
        for bump in [b for b in self._bumps if not b.again and self._is_seen_free(b)]:
            self._reopen(bump)

    def open_all(self) -> bool:
        """Open all that is closed, to be tried once more; whether there was any."""
        any_closed = bool(self._bumps)
        while self._bumps:
            self._reopen(self._bumps[0])
        return any_closed

    def stand_on(self, cell: Cell) -> None:
        """The robot is on this world cell, so nothing holds it up there."""
        if cell in self._closed:
            for bump in [b for b in self._bumps if cell in b.cells]:
                self._open(bump)
            self._write(*cell, ly.FREE, 0)
        if self._opened:
            self._opened = [b for b in self._opened if cell not in b.felt]

    def follow_window(self) -> None:
        """Forget what the window has left."""
        held = {cell for cell in self._closed if self._window.holds(*cell)}
        self._closed = {cell: self._closed[cell] for cell in held}
        kept = [b._replace(felt=b.felt & held, guessed=b.guessed & held) for b in self._bumps]
        self._bumps = [bump for bump in kept if bump.cells]

    def state_dict(self) -> Arrays:
        """Return all that is closed, and what was opened to be tried again; a row of `cell` is
        (bump, x, y, whether guessed), one of `closed` (x, y, raw, top) as it was."""
        opened = self._opened[-_MOST:]
        every = (*opened, *self._bumps)
        cells = [
            (i, *cell, guessed)
            for i, bump in enumerate(every)
            for guessed, held in enumerate((bump.felt, bump.guessed))
            for cell in sorted(held)
        ]
        closed = [(*cell, was.raw, was.top) for cell, was in self._closed.items()]
        return {
            "place_m": np.array([bump.place_m for bump in every]).reshape(-1, 2),
            "heading_rad": np.array([bump.heading_rad for bump in every], np.float64),
            "half_m": np.array([bump.half_m for bump in every], np.float64),
            "until_ns": np.array([bump.until_ns for bump in every], np.int64),
            "opened": np.arange(len(every)) < len(opened),
            "again": np.array([bump.again for bump in every], bool),
            "cell": np.array(cells, np.int64).reshape(-1, 4),
            "closed": np.array(closed, np.int64).reshape(-1, 4),
        }

    def load_state_dict(self, state: Arrays, later_ns: int) -> None:
        """Go on with a `state_dict`, in a map whose layers have these cells closed.

        Args:
            later_ns: how much later it all happened on the clock of now.
        """
        each = ("place_m", "heading_rad", "half_m", "until_ns", "opened", "again")
        rows = {each: 2 * _MOST, ("cell",): 1 << 16, ("closed",): 1 << 16}
        check_arrays(state, self.state_dict(), rows, {})
        cells, raw_top = state["cell"], state["closed"][:, 2:]
        if ((cells[:, ::3] < 0) | (cells[:, ::3] >= (len(state["opened"]), 2))).any():
            raise ValueError("cell: no such bump")
        if ((raw_top < 0) | (raw_top > 255)).any():
            raise ValueError("closed: not cells")
        self._opened, self._bumps = [], []
        held: dict[Cell, int] = {}
        for at, heading, half, until_ns, opened, again, (felt, guessed) in zip(
            *(state[name] for name in each), _by_bump(cells, len(state["opened"])), strict=True
        ):
            bump = _Bump(
                (float(at[0]), float(at[1])), float(heading), float(half), int(until_ns) + later_ns,
                felt, guessed, bool(again),
            )  # fmt: skip
            (self._opened if opened else self._bumps).append(bump)
            for cell in () if opened else bump.cells:
                held[cell] = held.get(cell, 0) + 1
        was = {(x, y): (raw, top) for x, y, raw, top in state["closed"].tolist()}
        self._closed = {c: _Closed(*was.get(c, (ly.FREE, 0)), n) for c, n in held.items()}
        self.follow_window()

    def explained(self, pose: SE2, place_m: tuple[float, float], radius_m: float) -> bool:
        """Whether an obstacle that was seen explains why a robot at `pose` is held up at a place.

        It does where it stands on the line from the robot through the place: from `radius_m`
        before the place to the inflation behind it. Half the robot's width counts: what is
        beside it, as the jambs of a door are beside its sill, does not hold it up; but for what
        the robot's front half touches, as the edge of a table in a turn.

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
        on_the_way = (-radius_m <= along) & (along <= beyond_m) & (np.abs(across) <= 0.5 * radius_m)
        ahead_m = along + math.dist(place_m, (pose.x_m, pose.y_m))  # of the robot's centre
        touched = (ahead_m >= 0.0) & (np.hypot(ahead_m, across) <= radius_m + res)
        return bool(
            np.any(
                (raw >= ly.OCCUPIED)
                & (raw != ly.BUMPED)
                & (on_the_way | touched)
                & (ox <= x) & (x < ox + n) & (oy <= y) & (y < oy + n)
            )
        )  # fmt: skip

    def _with_cells(self, bump: _Bump) -> _Bump:
        """A bump with the cells that it closes, as the map and the other bumps are now."""
        (x, y), touched_m = bump.across, self._off_trail(bump)
        felt: set[Cell] = set()
        if touched_m is not None:
            felt.add(self._window.cell_of(*touched_m))
            felt.update(self._along(touched_m, (x, y), bump.half_m))
            felt.update(self._along(touched_m, (-x, -y), bump.half_m))
        guessed: set[Cell] = set()
        for other in self._bumps:
            guessed.update(self._between(bump, other))
        held = {cell for cell in felt | guessed if self._window.holds(*cell)}
        return bump._replace(felt=frozenset(felt & held), guessed=frozenset(guessed & held - felt))

    def _off_trail(self, bump: _Bump) -> Place | None:
        """The touched place, moved on along the heading until it leaves the trail open.

        A thing on the trail itself is not closed: the robot came through there.
        """
        step_m, (x, y) = self._window.resolution_m, bump.place_m
        for k in range(math.ceil(self._clear_cells) + 1):
            at = (
                x + k * step_m * math.cos(bump.heading_rad),
                y + k * step_m * math.sin(bump.heading_rad),
            )
            if not self._near_trail(self._window.cell_of(*at)):
                return at
        return None

    def _near_trail(self, cell: Cell) -> bool:
        n = self._window.n
        return ly.near_trail(self._layers, cell[1] % n, cell[0] % n, self._clear_cells)

    def _is_seen_free(self, bump: _Bump) -> bool:
        """Whether most of what was touched was floor in the last updates, and nothing else."""
        top, n = self._layers.top, self._window.n
        seen = sum(top[y % n, x % n] >= SEEN_FREE for x, y in bump.felt)
        return 2 * seen > len(bump.felt)

    def _between(self, a: _Bump, b: _Bump) -> Iterator[Cell]:
        """Cells of the sill that two bumps make out; none where they are of two things."""
        gap_m = math.dist(a.place_m, b.place_m)
        if not self._window.resolution_m <= gap_m <= _SAME_SILL_M:
            return
        x, y = ((q - p) / gap_m for p, q in zip(a.place_m, b.place_m, strict=True))
        if any(
            abs(x * math.cos(bump.heading_rad) + y * math.sin(bump.heading_rad)) > _ACROSS
            for bump in (a, b)
        ):
            return
        on_m = min(gap_m, _GOES_ON_M)
        yield from self._along(a.place_m, (x, y), gap_m)
        yield from self._along(b.place_m, (-x, -y), gap_m)
        yield from self._along(b.place_m, (x, y), b.half_m + on_m)
        yield from self._along(a.place_m, (-x, -y), a.half_m + on_m)

    def _along(self, start_m: Place, way: Place, length_m: float) -> Iterator[Cell]:
        """Cells from a place on, as far as nothing that was seen and nowhere the robot was."""
        res, n = self._window.resolution_m, self._window.n
        for k in range(1, math.floor(2.0 * length_m / res) + 1):
            cell = self._window.cell_of(
                start_m[0] + 0.5 * k * res * way[0], start_m[1] + 0.5 * k * res * way[1]
            )
            stands = ly.OCCUPIED <= self._layers.raw[cell[1] % n, cell[0] % n] < ly.BUMPED
            if stands or self._near_trail(cell) or not self._window.holds(*cell):
                return
            yield cell

    def _close(self, bump: _Bump) -> None:
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
        if len(self._bumps) > _MOST:
            self._open(self._bumps[0])

    def _reopen(self, bump: _Bump) -> None:
        """Open a bump that may still be there: it is known until its time is over."""
        self._open(bump)
        self._opened.append(bump._replace(guessed=frozenset()))

    def _open(self, bump: _Bump) -> None:
        """Give the cells that no other bump has closed back the state that they had."""
        self._bumps.remove(bump)
        for cell in bump.cells:
            before = self._closed[cell]
            if before.bumps > 1:
                self._closed[cell] = before._replace(bumps=before.bumps - 1)
            else:
                del self._closed[cell]
                self._write(*cell, before.raw, before.top)


def _by_bump(cells: np.ndarray, n: int) -> list[tuple[frozenset[Cell], frozenset[Cell]]]:
    """(felt, guessed) of each of `n` bumps, from rows as `Bumps.state_dict` has them."""
    sets: list[tuple[set[Cell], set[Cell]]] = [(set(), set()) for _ in range(n)]
    for i, x, y, guessed in cells.tolist():
        sets[i][guessed].add((x, y))
    return [(frozenset(felt), frozenset(guessed)) for felt, guessed in sets]
