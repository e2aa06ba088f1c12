"""The prior: likelihood ratio of the target near a place, from the objects that were seen.

It uses the objects near the place with a free line of sight (`cooccurrence`), and the kind of room
that the place is in or leads to (`rooms`). A background thread cuts the map into rooms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from edge.config import Config
from edge.geometry import Grid
from edge.host.worker import Worker
from edge.mapping import regions
from edge.mapping.grid import RollingMap
from edge.mapping.layers import read_only
from edge.mapping.points import TALL
from edge.mapping.view import MapView
from edge.perception.prior import cooccurrence, rooms
from edge.perception.prior.cooccurrence import NEAR_M
from edge.perception.prior.nearby import nearby
from edge.perception.prior.table import ObjectPrior, load
from edge.perception.prior.words import PriorWordIndex, make_words
from edge.perception.tracking.sightings import TrackedObjects

PERIOD_NS = 1_000_000_000
CELL_M = 0.1
REGION_M = 0.7
"""Largest distance of an object from the cells of its region: it may be at a wall."""
SURE = 0.15
"""A sighting of this confidence has full weight, because the mean includes views from afar."""
LEAST, MOST = 0.25, 4.0
DRAWN_M, MOST_DRAWN = 0.3, 20_000
"""Side of a cell of `LocationPrior.layer`, and its largest number of cells. Cells of a large map
grow."""


class Rooms(NamedTuple):
    """The map cut into regions.

    Attributes:
        grid: See `regions.survey`.
        wall: (h, w) bool, True for walls.
        label: (h, w) int16, region of each cell, 1 … n.
        n: Number of regions.
        border: See `regions.borders`.
    """

    grid: Grid
    wall: np.ndarray
    label: np.ndarray
    n: int
    border: np.ndarray


class SeenObjects(NamedTuple):
    """Objects that were seen, as parallel arrays.

    Attributes:
        xyz_m: (n, 3) float32 in `map`.
        row: (n,) int32, row of the table; -1 if the object is not in it.
        weight: (n,) float32 in [0, 1], confidence in the object.
    """

    xyz_m: np.ndarray
    row: np.ndarray
    weight: np.ndarray


class LocationPrior:
    """The likelihood ratio of targets near places, from all objects seen; see `lift`.

    Args:
        by: `cooccurrence`, `rooms`, or `both`.
        table: Co-occurrence table of objects and rooms.
        words: Maps words to rows of the table.
        tall_code: Obstacles with at least this `Layers.top` are walls.
        inline: Cut the map inside `step`, so that a run is reproducible.
    """

    def __init__(
        self, by: str, table: ObjectPrior, words: PriorWordIndex, tall_code: int, inline: bool
    ) -> None:
        self._by, self._table, self._words, self._tall_code = by, table, words, tall_code
        self._chance, self._average = rooms.object_given_room(table), rooms.room_prior(table)
        self._worker: Worker[Callable[[], Rooms], Rooms] = Worker(
            "prior", lambda survey: survey(), inline=inline
        )
        self._sightings: TrackedObjects | None = None
        self._row = np.zeros(0, np.int32)  # of the sightings' words
        self._seen = -1
        self._version = 0
        self._asked_ns: int | None = None
        self._rooms = _NOWHERE
        self._places: tuple = ()
        self._xy_m = np.zeros((0, 2), np.float32)
        self._near = np.zeros((0, len(table.things)), np.float32)
        self._kind = np.zeros((0, len(table.kinds)))
        self._lifts: dict[str, np.ndarray] = {}
        self._layers: dict[str, Callable[[], Grid]] = {}
        self._drawn = (-1, -1)

    def through(self, wrap: Callable[[str, Any], Any]) -> None:
        """Wrap the worker with `wrap`, which logs its requests and results."""
        self._worker = wrap("prior", self._worker)

    def step(self, seen: MapView, sightings: TrackedObjects, now_ns: int) -> None:
        """Collect new rooms, once a tick, and request new ones when they are due."""
        self._sightings = sightings
        rested = self._asked_ns is None or now_ns - self._asked_ns >= PERIOD_NS
        if rested and sightings.n and self._worker.idle:
            self._asked_ns = now_ns
            layers, window, tall_code = seen.layers, seen.window, self._tall_code

            def survey() -> Rooms:
                grid = regions.coarse_grid(layers, window, tall_code, CELL_M)
                label, n = regions.segment_rooms(grid.cells, CELL_M)
                wall, border = grid.cells == regions.WALL, regions.border_lengths(label, n)
                return Rooms(grid, wall, label, n, border)

            self._worker.submit(survey)
        if (found := self._worker.poll()) is not None:
            self._rooms, self._version = found, self._version + 1

    def lift(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """Compute P(target near a place | objects seen) / P(target near an average place).

        Args:
            target: A prompt, or any word.
            xy_m: (n or more, 2) float32 in `map`; places of frontiers.
            n: Number of places.
            out: (n or more,) float32, written for the first n. 1 if nothing is known; always
                between `LEAST` and `MOST`.
        """
        row = self._words.row(target)
        if row < 0 or n == 0 or self._sightings is None or self._sightings.n == 0:
            out[:n] = 1.0
            return
        self._update_places(self._sightings, xy_m[:n])
        if target not in self._lifts:
            self._lifts[target] = self._lift(row, self._near, self._kind)
        out[:n] = self._lifts[target]

    def layer(self, target: str) -> Callable[[], Grid]:
        """Return a function that draws the current `lift` over the open part of the map.

        Returns:
            A function for any thread and any time. It returns a grid of uint8 on a logarithmic
            scale: 0 if nothing is known, else 1 (`LEAST`) … 128 (average place) … 255 (`MOST`).
        """
        s, rooms, row = self._sightings, self._rooms, self._words.row(target)
        if s is None or s.n == 0 or row < 0:
            return lambda: _NOWHERE.grid
        if self._drawn != (s.generation, self._version):
            self._drawn = s.generation, self._version
            self._layers.clear()
        if target not in self._layers:
            things = self._things(s)
            things = things._replace(xyz_m=read_only(things.xyz_m.copy()))
            self._layers[target] = cache(lambda: self._draw(row, things, rooms))
        return self._layers[target]

    def _draw(self, row: int, things: SeenObjects, rooms: Rooms) -> Grid:
        """Draw the layer, on any thread; see `layer`."""
        grid = rooms.grid
        step = max(
            round(DRAWN_M / grid.resolution_m), math.ceil(math.sqrt(grid.cells.size / MOST_DRAWN))
        )
        open_ = grid.cells[step // 2 :: step, step // 2 :: step] == regions.OPEN
        drawn = Grid(np.zeros(open_.shape, np.uint8), grid.origin_xy_m, step * grid.resolution_m)
        xy_m = drawn.to_metres(np.argwhere(open_)[:, ::-1] + 0.5).astype(np.float32)
        lift = self._lift(row, *self._surroundings(things, rooms, xy_m))
        share = np.log(lift / LEAST) / math.log(MOST / LEAST)
        drawn.cells[open_] = np.where(lift == 1.0, 0, np.round(1 + 254 * share))
        return drawn

    def forget(self) -> None:
        """Forget the rooms, since the map starts again empty."""
        self._worker.forget()
        self._rooms, self._version, self._asked_ns = _NOWHERE, self._version + 1, None

    def close(self) -> None:
        """Stop the background work."""
        self._worker.close()

    def _lift(self, row: int, near: np.ndarray, kind: np.ndarray) -> np.ndarray:
        """Return the likelihood ratio of places with these surroundings, (n,) float32."""
        lift = np.ones(len(near), np.float32)
        if self._by != "rooms":
            cooccurrence.likelihood_ratio(self._table, row, near, lift)
        if self._by != "cooccurrence":
            power = self._table.room_power[self._by == "both"]
            lift *= rooms.likelihood_ratio(self._chance, self._average, row, kind) ** power
        return np.clip(lift, LEAST, MOST, out=lift)

    def _update_places(self, s: TrackedObjects, xy_m: np.ndarray) -> None:
        """Compute the near objects and the rooms of these places, if something changed."""
        same = s.generation == self._seen and self._places == (self._version, len(xy_m))
        if same and np.array_equal(xy_m, self._xy_m):
            return
        self._seen, self._places = s.generation, (self._version, len(xy_m))
        self._xy_m = np.array(xy_m, np.float32)
        self._lifts.clear()
        self._near, self._kind = self._surroundings(self._things(s), self._rooms, self._xy_m)

    def _things(self, s: TrackedObjects) -> SeenObjects:
        if len(s.words) != len(self._row):
            self._row = np.array([self._words.row(word) for word in s.words], np.int32)
        weight = np.minimum(s.confidence[: s.n] / np.float32(SURE), np.float32(1.0))
        return SeenObjects(s.xyz_m[: s.n], self._row[s.word[: s.n]], weight)

    def _surroundings(
        self, things: SeenObjects, known: Rooms, xy_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the surroundings of places.

        Returns:
            Confidence that each object is near each place, (n, objects) float32; and the kinds of
            the places' rooms, see `_kinds`. An array that `by` does not use is 0.
        """
        n = len(xy_m)
        near = np.zeros((n, len(self._table.things)), np.float32)
        if self._by != "rooms":
            grid = known.grid
            nearby(
                known.wall, *grid.origin_xy_m, grid.resolution_m, xy_m, n,
                things.xyz_m, things.row, things.weight, len(things.row), NEAR_M, near,
            )  # fmt: skip
        if self._by == "cooccurrence":
            return near, np.zeros((n, len(self._table.kinds)))
        return near, self._kinds(things, known, xy_m)

    def _kinds(self, things: SeenObjects, known: Rooms, xy_m: np.ndarray) -> np.ndarray:
        """Return P(kind of room) for each place, (n, kinds) float64."""
        held = np.zeros((known.n + 1, len(self._table.things)), np.float32)
        at = _regions(known, things.xyz_m)
        counts = (at > 0) & (things.row >= 0)
        np.maximum.at(held, (at[counts], things.row[counts]), things.weight[counts])
        next_to = rooms.neighbours(known.border, held)
        here = _regions(known, xy_m)
        return rooms.room_posterior_at(self._table, self._chance, held[here], held[next_to[here]])


def _regions(known: Rooms, xy_m: np.ndarray) -> np.ndarray:
    """Return the region of each place, (n,) int16; see `regions.regions_at`."""
    grid, out = known.grid, np.empty(len(xy_m), np.int16)
    regions.regions_at(
        known.label, *grid.origin_xy_m, grid.resolution_m, xy_m, len(xy_m), REGION_M, out
    )
    return out


_NOWHERE = Rooms(
    Grid(np.zeros((0, 0), np.uint8), (0.0, 0.0), CELL_M),
    np.zeros((0, 0), np.bool_),
    np.zeros((0, 0), np.int16),
    0,
    np.zeros((1, 1), np.int64),
)


def make_prior(config: Config) -> LocationPrior | None:
    """Return the configured prior, or None."""
    perception = config.perception
    if perception.prior == "none":
        return None
    table = load()
    words = make_words(table, perception.detector)
    return LocationPrior(perception.prior, table, words, TALL, config.loop.lockstep)


def warm_up(config: Config) -> None:
    """Compile the kernels of the prior, or read them from the cache."""
    grid, sightings = RollingMap(config.mapping), TrackedObjects(1)
    grid.update_cloud(np.zeros((0, 3), np.float32), np.eye(4), np.eye(4))
    table = load()
    prior = LocationPrior("both", table, PriorWordIndex(table), TALL, inline=True)
    sightings.words.append(table.things[0])
    sightings.n = 1
    prior.step(MapView(grid), sightings.read_only(), 0)
    prior.lift(table.things[0], np.zeros((1, 2), np.float32), 1, np.empty(1, np.float32))
