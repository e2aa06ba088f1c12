"""Benchmark: cost of a configured choice scorer in the tick that calls it, and of our own model."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from test_mapping import CAMERA, T_BASE_CAMERA

from edge import config
from edge.config import parse
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.goals.candidates import CandidatePool
from edge.loop.scoring.scorers import Scorers
from edge.mapping import grid
from edge.mapping.results import Frontiers
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.scoring.choice.factory import ViewScorer, open_view_scorer
from edge.perception.scoring.choice.question import Mark, MarkCosts, MarkedView
from edge.perception.tracking.instances import InstanceTracker
from edge.types import Observation

CANDIDATES = 200


class Idle:
    """A scorer that is asked in the tick and does nothing."""

    name = "idle"

    def prepare(self, question: object) -> None:
        return None

    def answer(self, looked: object) -> None:
        return None

    def close(self) -> None:
        return None


def test_ask_choice_200(benchmark):
    """Measure a question about 200 frontiers on all sides; the image shows a few of them."""
    benchmark.extra_info["budget"] = "ask_choice_200"
    rng = np.random.default_rng(1)
    xy_m = rng.uniform(-8.0, 8.0, (CANDIDATES, 2)).astype(np.float32)
    sizes, ids = np.full(CANDIDATES, 10, np.int32), np.arange(CANDIDATES, dtype=np.int32)
    pool = CandidatePool(CANDIDATES, 0.01)
    pool.update(Frontiers(CANDIDATES, xy_m, sizes, ids), [], 1, 1)
    depth = np.full((CAMERA.height_px, CAMERA.width_px), 9.0, np.float32)
    observation = Observation(
        0, 1, SE2(0.0, 0.0, 0.3).matrix(), depth_m=depth, camera=CAMERA,
        T_base_camera=T_BASE_CAMERA,
    )  # fmt: skip
    scorers = Scorers(None, Idle(), inline=True)
    tracker = InstanceTracker(config.PerceptionConfig(detector=config.DetectorSim()))
    values = grid.RollingMap(config.MappingConfig()).values
    benchmark(scorers.ask, observation, ("chair",), "chair", pool.candidates, tracker, values)
    assert scorers.status()["choice"]["failed"] == 0


def test_choose_mini_house(benchmark, against):
    """Compare the choice among four marks with a detection by the same trunk, on one thread."""
    benchmark.extra_info["budget"] = "choose_mini_house"
    rgb = np.random.default_rng(0).integers(0, 256, (256, 320, 3), np.uint8)
    observation = Observation(0, 1, np.eye(4), rgb=rgb)
    scorer = open_view_scorer(config.ChoiceOnnx(card="mini-house-choice", threads=1))
    marks = tuple(Mark(i, 60.0 * i, 150.0, 0.5 - 0.3 * i, 2.0) for i in range(4))
    ways = MarkCosts(np.full(4, 2.5, np.float32), np.ones(4, np.float32), np.zeros(3, np.float32))
    view = MarkedView(observation, "bed", marks, mark_costs=ways)
    choice = benchmark(lambda: scorer.answer(scorer.prepare(view)))
    assert choice.ids == (0, 1, 2, 3)
    of_trunk = config.DetectorOnnx(model="mini-house-256x320-int8-cpu", threads=1)
    detector = OnnxDetector(of_trunk, ["bed"])
    against(lambda: detector.detect(observation))


class Busy:
    """A scorer that answers one question until it is closed; its network runs all the time."""

    def __init__(self, scorer: ViewScorer) -> None:
        self.name, self._scorer, self._over = scorer.name, scorer, threading.Event()
        self.runs = 0

    def prepare(self, view: MarkedView) -> object:
        return self._scorer.prepare(view)

    def answer(self, looked: object) -> None:
        while not self._over.is_set():
            self._scorer.answer(looked)
            self.runs += 1

    def close(self) -> None:
        self._over.set()


@pytest.mark.parametrize("asks", [False, True])
def test_tick(benchmark, monkeypatch, asks):
    """Measure a tick while a scorer's network runs, and one without scorers, on the same drive."""
    benchmark.extra_info["budget"] = "tick_choosing" if asks else "tick_not_choosing"
    choice = config.ChoiceOnnx(card="mini-house-choice", threads=1)
    busy = Busy(open_view_scorer(choice))
    scorers = Scorers(None, busy) if asks else None
    monkeypatch.setattr("edge.lab.eval.closed_loop.make_scorers", lambda *_: scorers)
    loop = ClosedLoop(
        parse({
            "loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.05},
            "perception": {"detector": {"kind": "sim"}, "choice": choice.model_dump()},
            "mission": {"target": "toilet"},
        })
    )  # fmt: skip

    def drive() -> tuple[tuple, dict]:
        loop.step()
        return (loop.observe(), loop.drive.motion.stamp_ns), {}

    benchmark.pedantic(loop.service.tick, setup=drive, rounds=300, warmup_rounds=20)
    loop.close()
    if scorers is not None:
        assert scorers.status()["choice"]["failed"] == 0
        assert busy.runs > 10
