"""Benchmark: cost of the prior in the tick: 100 places among 200 objects, new or known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from test_mapping import explored_map

from edge.config import DetectorSim
from edge.loop.scoring.prior import LocationPrior
from edge.mapping.points import TALL
from edge.mapping.regions import survey_regions
from edge.mapping.view import MapView
from edge.memory import NO_SURVEY, RoomMemory, Site, survey_rooms
from edge.perception.prior.table import load
from edge.perception.prior.words import make_words
from edge.perception.tracking.object_tracker import MAX_TRACKED
from edge.perception.tracking.tracked_objects import TrackedObjects

PLACES, THINGS = 100, 200


def objects(n: int, words: Sequence[str]) -> TrackedObjects:
    """Return n objects anywhere in a house of 10 m × 10 m."""
    rng, known = np.random.default_rng(0), TrackedObjects(n)
    known.words[:] = words
    known.n, known.generation = n, 1
    known.xyz_m[:n, :2] = rng.uniform(-5, 5, (n, 2))
    known.word[:n] = rng.integers(0, len(words), n)
    known.confidence[:n] = rng.uniform(0.1, 0.8, n)
    return known


@pytest.fixture(scope="module")
def seen() -> tuple[LocationPrior, MapView, TrackedObjects, np.ndarray]:
    """Return the state after all of a house of 10 m × 10 m was seen."""
    rng, table = np.random.default_rng(0), load()
    known = objects(THINGS, table.classes)
    words = make_words(table, DetectorSim())
    prior = LocationPrior("both", table, words)
    view = MapView(explored_map(1000))
    places = rng.uniform(-5, 5, (PLACES, 2)).astype(np.float32)
    return prior, view, known, places


def test_nothing_new(benchmark, seen):
    benchmark.extra_info["budget"] = "prior_unchanged_100"
    prior, view, known, places = seen
    prior.step(survey_regions(view.layers, view.window, TALL), known)
    out = np.empty(PLACES, np.float32)
    regions = survey_regions(view.layers, view.window, TALL)

    def step() -> None:
        prior.step(regions, known)
        prior.likelihood_ratio("television", places, PLACES, out)

    benchmark(step)
    assert out.std() > 0


def test_all_new(benchmark, seen):
    benchmark.extra_info["budget"] = "prior_changed_100"
    prior, view, known, places = seen
    prior.step(survey_regions(view.layers, view.window, TALL), known)
    out = np.empty(PLACES, np.float32)

    def step() -> None:
        known.generation += 1
        prior.likelihood_ratio("television", places, PLACES, out)

    benchmark(step)
    assert out.std() > 0


def test_cut_rooms(benchmark, seen):
    """Measure the division of the map into rooms, in the background once a second."""
    benchmark.extra_info["budget"] = "prior_rooms_1000"
    view = seen[1]
    regions = benchmark(survey_regions, view.layers, view.window, TALL)
    assert regions.n > 0


def test_kinds_of_rooms(benchmark, seen):
    """Measure the kinds of rooms with a full memory; the tick computes them once a second."""
    benchmark.extra_info["budget"] = "room_kinds_5000"
    view, table = seen[1], load()
    known = objects(MAX_TRACKED, table.classes)
    memory = RoomMemory(table, make_words(table, DetectorSim()))
    memory.on_survey(survey_rooms(survey_regions(view.layers, view.window, TALL), NO_SURVEY))

    def update() -> None:
        memory.set_site(Site())
        memory.update(known, 0)

    benchmark(update)
    assert memory.rooms
