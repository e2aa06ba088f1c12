"""What a configured choice scorer costs the tick in which it is asked."""

from __future__ import annotations

import numpy as np
from test_mapping import CAMERA, T_BASE_CAMERA

from edge import config
from edge.geometry import SE2
from edge.loop.candidates import CandidatePool
from edge.loop.scorers import Scorers
from edge.mapping import grid
from edge.mapping.results import Frontiers
from edge.perception.instances import InstanceTracker
from edge.types import Observation

CANDIDATES = 200


class Idle:
    """A scorer that is asked in the tick and does nothing."""

    name = "idle"

    def look(self, question: object) -> None:
        return None

    def answer(self, looked: object) -> None:
        return None

    def close(self) -> None:
        return None


def test_ask_choice_200(benchmark):
    """200 frontiers all around, of which the image shows a few."""
    benchmark.extra_info["budget"] = "ask_choice_200"
    rng = np.random.default_rng(1)
    xy_m = rng.uniform(-8.0, 8.0, (CANDIDATES, 2)).astype(np.float32)
    sizes, ids = np.full(CANDIDATES, 10, np.int32), np.arange(CANDIDATES, dtype=np.int32)
    pool = CandidatePool(CANDIDATES, 0.01)
    pool.update(Frontiers(CANDIDATES, xy_m, sizes, ids), [], 1, 1)
    depth = np.full((CAMERA.height_px, CAMERA.width_px), 9.0, np.float32)
    seen = Observation(
        0, 1, SE2(0.0, 0.0, 0.3).matrix(), depth_m=depth, camera=CAMERA,
        T_base_camera=T_BASE_CAMERA,
    )  # fmt: skip
    scorers = Scorers(None, Idle(), inline=True)
    tracker = InstanceTracker(config.Perception(detector=config.DetectorSim()))
    values = grid.RollingMap(config.Mapping()).values
    benchmark(scorers.ask, seen, ("chair",), "chair", pool.candidates, tracker, values)
    assert scorers.status()["choice"]["failed"] == 0
