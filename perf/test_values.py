"""Benchmark: update and reading of the value maps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from test_mapping import CAMERA, MAPPING, T_BASE_CAMERA, explored_map, frames

from edge.loop.warmup import warm_mapping, warm_values
from edge.types import Observation

TARGETS = ("bed", "chair", "sofa", "toilet")
SCORE = np.array([0.2, 0.3, 0.4, 0.5], np.float32)


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_mapping(MAPPING)
    warm_values(MAPPING)


def views() -> list[Observation]:
    """Return the observations of the explored map's frames."""
    return [
        Observation(0, 0, pose.matrix(), depth_m=depth, camera=CAMERA, T_base_camera=T_BASE_CAMERA)
        for depth, _, pose in frames()
    ]


def test_four_channels(benchmark):
    """Measure all steps from a depth image of 480 x 640 to the map of 1000 x 1000 cells."""
    benchmark.extra_info["budget"] = "value_update_4_channels"
    m = explored_map(1000)
    m.values.set_targets(TARGETS)
    seen = itertools.cycle(views())
    benchmark(lambda: m.values.write_view(m.values.range_profile(next(seen)), TARGETS, SCORE))
    assert m.values.weight.any(axis=(0, 1)).all()


def test_values_of_100_frontiers(benchmark):
    """Benchmark: cost of reading frontier values in a tick of a value policy."""
    benchmark.extra_info["budget"] = "value_best_100"
    m = explored_map(1000)
    m.values.set_targets(TARGETS)
    for observation in views():
        m.values.write_view(m.values.range_profile(observation), TARGETS, SCORE)
    xy_m = np.random.default_rng(1).uniform(-5, 5, (100, 2)).astype(np.float32)
    xy_m.flags.writeable = False
    out = np.zeros(100, np.float32)
    benchmark(m.values.best, 2, xy_m, 100, 0.5, out)
    assert np.nanmax(out) == pytest.approx(0.4, abs=1e-3)
