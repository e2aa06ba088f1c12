"""The prior in the tick: 100 places among 200 sightings, all of it new, or nothing new."""

from __future__ import annotations

import numpy as np
import pytest
from test_mapping import explored_map

from edge.config import DetectorSim
from edge.loop.prior import LocationPrior
from edge.mapping.points import HEIGHT_CODES
from edge.mapping.view import MapView
from edge.perception.prior.table import load
from edge.perception.prior.words import make_words
from edge.perception.tracking.sightings import TrackedObjects

PLACES, THINGS = 100, 200


@pytest.fixture(scope="module")
def seen() -> tuple[LocationPrior, MapView, TrackedObjects, np.ndarray]:
    """As after a house of 10 m × 10 m was seen whole."""
    rng, table = np.random.default_rng(0), load()
    sightings = TrackedObjects(512)
    sightings.words[:] = table.things
    sightings.n, sightings.generation = THINGS, 1
    sightings.xyz_m[:THINGS, :2] = rng.uniform(-5, 5, (THINGS, 2))
    sightings.word[:THINGS] = rng.integers(0, len(table.things), THINGS)
    sightings.confidence[:THINGS] = rng.uniform(0.1, 0.8, THINGS)
    words = make_words(table, DetectorSim())
    prior = LocationPrior("both", table, words, int(0.85 * HEIGHT_CODES), inline=True)
    view = MapView(explored_map(1000))
    places = rng.uniform(-5, 5, (PLACES, 2)).astype(np.float32)
    return prior, view, sightings, places


def test_nothing_new(benchmark, seen):
    benchmark.extra_info["budget"] = "prior_lift_100"
    prior, view, sightings, places = seen
    prior.step(view, sightings, 0)
    out = np.empty(PLACES, np.float32)

    def look() -> None:
        prior.step(view, sightings, 1)
        prior.lift("television", places, PLACES, out)

    benchmark(look)
    assert out.std() > 0


def test_all_new(benchmark, seen):
    benchmark.extra_info["budget"] = "prior_look_100"
    prior, view, sightings, places = seen
    prior.step(view, sightings, 0)
    out = np.empty(PLACES, np.float32)

    def look() -> None:
        sightings.generation += 1
        prior.lift("television", places, PLACES, out)

    benchmark(look)
    assert out.std() > 0


def test_cut_rooms(benchmark, seen):
    """Beside the loop, once a second."""
    benchmark.extra_info["budget"] = "prior_rooms_1000"
    prior, view, sightings, _ = seen

    def cut() -> None:
        prior.forget()
        prior.step(view, sightings, 0)

    benchmark(cut)
