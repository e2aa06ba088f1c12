"""The prior: likelihood ratio of the target near a place, from the objects that were seen.

It uses the objects near the place with a free line of sight (`cooccurrence`), and the kind of room
that the place is in or leads to (`rooms`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from edge.config import Config
from edge.geometry import Grid
from edge.mapping.layers import read_only
from edge.mapping.regions import NO_REGIONS, OPEN, RegionMap
from edge.memory import SeenObjectIndex, SeenObjects, kinds_by_region, objects_by_region
from edge.perception.prior import cooccurrence, rooms
from edge.perception.prior.cooccurrence import NEAR_M
from edge.perception.prior.nearby import nearby
from edge.perception.prior.table import ObjectPrior, load
from edge.perception.prior.words import PriorWordIndex
from edge.perception.tracking.tracked_objects import TrackedObjects

LEAST, MOST = 0.25, 4.0
"""Limits of the likelihood ratio."""
DRAWN_M, MOST_DRAWN = 0.3, 20_000
"""Side of a cell of `LocationPrior.layer`, and the largest number of cells; a large map has larger
cells."""


class LocationPrior:
    """The likelihood ratio of targets near places, from all objects seen; see `likelihood_ratio`.

    Attributes:
        words: As in `Args`; with the detector's vocabulary if it has one.
    """

    def __init__(self, by: str, table: ObjectPrior, words: PriorWordIndex) -> None:
        self.words = words
        self._by, self._table = by, table
        self._index = SeenObjectIndex(words)
        self._objects: TrackedObjects | None = None
        self._regions_version = 0
        self._regions = NO_REGIONS
        # Places of the newest `likelihood_ratio`, what is around them (`_surroundings`), and the
        # ratio by target; valid for this version of the objects and of the regions.
        self._places_version = (-1, -1)
        self._xy_m = np.zeros((0, 2), np.float32)
        self._near_objects = np.zeros((0, len(table.classes)), np.float32)
        self._room_kinds = np.zeros((0, len(table.kinds)))
        self._ratios: dict[str, np.ndarray] = {}
        # Layers by target, for this version of the objects and of the regions.
        self._layers: dict[str, Callable[[], Grid]] = {}
        self._layers_version = (-1, -1)

    def step(self, regions: RegionMap, objects: TrackedObjects) -> None:
        """Use the newest regions of the map and the objects seen; call it once a tick."""
        self._objects = objects
        if regions is not self._regions:
            self._regions, self._regions_version = regions, self._regions_version + 1

    def likelihood_ratio(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """Compute P(target near a place | objects seen) / P(target near an average place).

        Args:
            target: A prompt, or any word.
            xy_m: (n or more, 2) float32 in `map`; places of frontiers.
            n: Number of places.
            out: (n or more,) float32, written for the first n. 1 if nothing is known; always
                between `LEAST` and `MOST`.
        """
        row = self.words.row(target)
        if row < 0 or n == 0 or self._objects is None or self._objects.n == 0:
            out[:n] = 1.0
            return
        self._update_places(self._objects, xy_m[:n])
        if target not in self._ratios:
            self._ratios[target] = self._ratio_of(row, self._near_objects, self._room_kinds)
        out[:n] = self._ratios[target]

    def layer(self, target: str) -> Callable[[], Grid]:
        """Return a function that draws `likelihood_ratio` now, over the open part of the map.

        Returns:
            A function for any thread and any time. It returns a grid of uint8 on a logarithmic
            scale: 0 if nothing is known, else 1 (`LEAST`) … 128 (average place) … 255 (`MOST`).
        """
        objects, regions, row = self._objects, self._regions, self.words.row(target)
        if objects is None or objects.n == 0 or row < 0:
            return lambda: NO_REGIONS.grid
        if self._layers_version != (objects.generation, self._regions_version):
            self._layers_version = objects.generation, self._regions_version
            self._layers.clear()
        if target not in self._layers:
            seen = self._index.of(objects)
            seen = seen._replace(xyz_m=read_only(seen.xyz_m.copy()))
            self._layers[target] = cache(lambda: self._draw(row, seen, regions))
        return self._layers[target]

    def _draw(self, row: int, seen: SeenObjects, regions: RegionMap) -> Grid:
        """Draw the layer, on any thread; see `layer`."""
        grid = regions.grid
        step = max(
            round(DRAWN_M / grid.resolution_m), math.ceil(math.sqrt(grid.cells.size / MOST_DRAWN))
        )
        is_open = grid.cells[step // 2 :: step, step // 2 :: step] == OPEN
        drawn = Grid(np.zeros(is_open.shape, np.uint8), grid.origin_xy_m, step * grid.resolution_m)
        xy_m = drawn.to_metres(np.argwhere(is_open)[:, ::-1] + 0.5).astype(np.float32)
        ratio = self._ratio_of(row, *self._surroundings(seen, regions, xy_m))
        share = np.log(ratio / LEAST) / math.log(MOST / LEAST)
        drawn.cells[is_open] = np.where(ratio == 1.0, 0, np.round(1 + 254 * share))
        return drawn

    def _ratio_of(self, row: int, near_objects: np.ndarray, room_kinds: np.ndarray) -> np.ndarray:
        """Return the likelihood ratio of places with these surroundings, (n,) float32."""
        ratio = np.ones(len(near_objects), np.float32)
        if self._by != "rooms":
            cooccurrence.likelihood_ratio(self._table, row, near_objects, ratio)
        if self._by != "cooccurrence":
            # [0] is the exponent for `rooms` alone, [1] that for `both`.
            power = self._table.room_power[self._by == "both"]
            ratio *= rooms.likelihood_ratio(self._table, row, room_kinds) ** power
        return np.clip(ratio, LEAST, MOST, out=ratio)

    def _update_places(self, objects: TrackedObjects, xy_m: np.ndarray) -> None:
        """Compute the near objects and the rooms of these places, if something changed."""
        version = objects.generation, self._regions_version
        if version == self._places_version and np.array_equal(xy_m, self._xy_m):
            return
        self._places_version = version
        self._xy_m = np.array(xy_m, np.float32)
        self._ratios.clear()
        seen = self._index.of(objects)
        self._near_objects, self._room_kinds = self._surroundings(seen, self._regions, self._xy_m)

    def _surroundings(
        self, seen: SeenObjects, regions: RegionMap, xy_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the surroundings of places.

        Returns:
            Confidence that each object is near each place, (n, objects) float32; and the kinds of
            the places' rooms, see `_kinds_of_rooms`. An array that `by` does not use is 0.
        """
        n = len(xy_m)
        near_objects = np.zeros((n, len(self._table.classes)), np.float32)
        if self._by != "rooms":
            grid = regions.grid
            nearby(
                regions.wall, *grid.origin_xy_m, grid.resolution_m, xy_m, n,
                seen.xyz_m, seen.row, seen.weight, len(seen.row), NEAR_M, near_objects,
            )  # fmt: skip
        if self._by == "cooccurrence":
            return near_objects, np.zeros((n, len(self._table.kinds)))
        return near_objects, self._kinds_of_rooms(seen, regions, xy_m)

    def _kinds_of_rooms(
        self, seen: SeenObjects, regions: RegionMap, xy_m: np.ndarray
    ) -> np.ndarray:
        """Return P(kind of room) for each place, (n, kinds) float64."""
        objects = objects_by_region(regions, seen, len(self._table.classes))
        return kinds_by_region(self._table, regions.border, objects)[regions.at(xy_m)]


def make_prior(config: Config, words: PriorWordIndex) -> LocationPrior | None:
    """Return the configured prior, or None."""
    by = config.perception.prior
    return None if by == "none" else LocationPrior(by, load(), words)
