"""The shedder over a real swapper and worker, with detectors of a given slowness."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from patience import eventually
from simulated import simulated

from edge.config import parse
from edge.geometry import CameraModel
from edge.host.board import BoardReading
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop import degradation
from edge.loop import load_shedder as module
from edge.loop.load_shedder import LoadShedder
from edge.loop.status import status_message
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth
from edge.perception.swap import detector as swapped
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker
from edge.types import Detections, Observation

MS, TICK_NS = 1_000_000, 100_000_000
COOL = BoardReading({"tj": 50.0}, {("tj", "passive"): 99.0}, {}, {}, {}, {}, "MAXN")
HOT = BoardReading({"tj": 97.0}, {("tj", "passive"): 99.0}, {}, {}, {}, {}, "MAXN")
LEVELS = [{"model": "small"}, {"pause": "choice"}]


class Fake:
    """Finds nothing, and says that it took so long."""

    def __init__(self, name: str, ms: float, ill: str = "") -> None:
        self.name, self.ms, self.ill, self.closed = name, ms, ill, False
        self.prompts: tuple[str, ...] = ("chair",)
        self.invalid_boxes = 0

    def set_prompts(self, prompts):
        self.prompts = tuple(prompts)

    def detect(self, observation):
        return Detections(
            observation, np.zeros((0, 4), np.float32), np.zeros(0, np.float32),
            np.zeros(0, np.int32), self.prompts, latency_ns=int(self.ms * MS),
        )  # fmt: skip

    def health(self):
        return ModelHealth("degraded", self.ill) if self.ill else ModelHealth()

    def close(self):
        self.closed = True


class Bench:
    """Ten images a second of the loop's time; `models` makes those that are asked for."""

    def __init__(self, levels=LEVELS, board=COOL) -> None:
        config = parse({
            "perception": {
                "detector": {"kind": "onnx", "model": "large"},
                "choice": {"kind": "text", "url": "http://127.0.0.1:1/v1", "model": "m"},
                "swap": {"probation": 2},
                "load_shedding": {"levels": levels},
            }
        })  # fmt: skip
        self.config, self.board, self.said = config, board, []
        self.models = {"large": Fake("large", 20.0), "small": Fake("small", 10.0)}
        self.worker = DetectorWorker(self.models["large"], inline=True)
        self.scorers = SimpleNamespace(shed=frozenset())
        self.swapper = DetectorSwap(config.perception, self.worker, lambda *_: None, self._make)
        self.shedder = LoadShedder(
            config.perception, self.worker, self.swapper, self.scorers,
            lambda text, now_ns: self.said.append(text), self._read,
        )  # fmt: skip
        self.now_ns = self.reads = 0

    def _make(self, perception, prompts, progress, cancelled):
        model = self.models[perception.detector.model]
        if isinstance(model, Exception):
            raise model
        model.closed = False
        return model

    def _read(self) -> BoardReading:
        self.reads += 1
        if isinstance(self.board, Exception):
            raise self.board
        return self.board

    @property
    def running(self) -> str:
        return self.worker.detector.name

    def run(self, seconds: float) -> Bench:
        for _ in range(int(seconds * 10)):
            self.see()
            self.swapper.step(self.now_ns)
            self.shedder.step(self.now_ns)
        return self

    def see(self) -> None:
        """Feed the next image."""
        self.now_ns += TICK_NS
        seen = Observation(
            self.now_ns // TICK_NS, self.now_ns, np.eye(4), rgb=np.zeros((8, 8, 3), np.uint8),
            camera=CameraModel.from_hfov(8, 8, 1.3),
        )  # fmt: skip
        self.worker.submit(seen)
        # The reported duration replaces a clock.
        self.worker.stats.last_latency_ns = int(self.worker.detector.ms * MS)

    def until(self, what) -> Bench:
        eventually(lambda: self.run(1.0) and what(), f"never: {self.shedder.status()}")
        return self

    def sees(self, board: BoardReading) -> Bench:
        """Wait until the shedder has read this of the board."""
        self.board = board
        self.shedder._board._rest_s = 0.0
        return self.until(lambda: self.shedder._reading is board)

    def close(self) -> None:
        self.shedder.close()
        self.swapper.close()
        self.worker.close()


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(module, "_check_model_is_here", lambda name: None)
    monkeypatch.setattr(module, "BOARD_S", 0.01)
    monkeypatch.setattr(swapped, "IMAGES", 1)
    for name, seconds in {"OVER_S": 2.0, "DWELL_S": 5.0, "LOW_S": 10.0}.items():
        monkeypatch.setattr(degradation, name, seconds)
    opened = []

    def make(**more) -> Bench:
        opened.append(Bench(**more))
        return opened[-1]

    yield make
    for one in opened:
        one.close()


def test_a_slow_detector_steps_down_and_recovers(bench):
    b = bench()
    b.models["large"].ms, b.models["small"].ms = 60.0, 40.0
    b.until(lambda: b.shedder.level == 1)
    assert (b.running, b.scorers.shed) == ("small", frozenset())
    assert b.said == [
        "load shedding: down to level 1 of 2: model small: detect takes 60 ms (median), above "
        "perception.swap.budget_ms (33), for over 2 s"
    ]
    b.until(lambda: b.shedder.level == 2)
    assert b.scorers.shed == {"choice"}
    assert b.said[1].startswith(
        "load shedding: down to level 2 of 2: pause choice: detect takes 40"
    )
    assert b.shedder.status()["paused"] == ["choice"]
    b.models["large"].ms, b.models["small"].ms = 12.0, 8.0
    b.until(lambda: b.shedder.level == 0)
    assert (b.running, b.scorers.shed) == ("large", frozenset())
    assert [line.split(":")[1].strip() for line in b.said[2:]] == [
        "up to level 1 of 2", "up to level 0 of 2",
    ]  # fmt: skip
    assert b.shedder.steps == {"down": 2, "up": 2}


def test_a_hot_board_steps_down_and_names_the_sensor(bench):
    b = bench().sees(HOT)
    b.until(lambda: b.shedder.level == 1)
    assert "model small: tj is at 97 C, passive from 99 C, for over 2 s" in b.said[0]
    assert b.shedder.status()["distress"] == "tj is at 97 C, passive from 99 C"


def test_a_damaged_model_is_skipped(bench):
    b = bench()
    b.models["large"].ms, b.models["small"] = 60.0, ModelError("small.onnx: damaged")
    b.until(lambda: b.shedder.level == 2)
    assert b.running == "large"
    assert b.said[1] == "load shedding: level 1 cannot be used: small.onnx: damaged; large goes on"
    assert b.scorers.shed == {"choice"}
    b.models["large"].ms = 10.0
    b.until(lambda: b.shedder.level == 0)


def test_a_model_that_cannot_return_keeps_the_small_one(bench):
    b = bench(levels=LEVELS[:1])
    large = b.models["large"]
    large.ms = 60.0
    b.until(lambda: b.running == "small")
    b.models["large"] = ModelError("large.onnx: damaged")
    b.until(lambda: len(b.said) == 3)
    assert b.said[2] == "load shedding: level 0 cannot be used: large.onnx: damaged; small goes on"
    assert (b.shedder.level, b.running) == (1, "small")


def test_the_shedder_waits_while_a_requested_model_runs(bench):
    b = bench()
    b.models["own"] = Fake("own", 80.0)
    b.swapper.request("own", True, b.now_ns)
    b.until(lambda: b.running == "own" and b.swapper.state == "kept")
    b.run(30)
    assert (b.shedder.status()["state"], b.said) == ("waiting", [])
    b.swapper.request("large", True, b.now_ns)
    b.until(lambda: b.running == "large" and b.swapper.state == "kept")
    b.models["large"].ms = 60.0
    b.until(lambda: b.shedder.level == 1)


def test_another_power_mode_is_reported(bench):
    b = bench().sees(COOL).sees(COOL.__class__({}, {}, {}, {}, {}, {}, "15W"))
    (said,) = b.said
    assert said.startswith("load shedding: the board's power mode changed from MAXN to 15W; ")
    assert b.shedder.status()["power_mode"] == "15W"


def test_an_unreadable_board_sensor_is_ignored(bench):
    b = bench(board=OSError("no such sensor"))
    b.until(lambda: b.reads)
    b.models["large"].ms = 60.0
    b.until(lambda: b.shedder.level == 1)
    assert b.shedder.status()["power_mode"] is None


def test_another_detector_resets_the_levels_unlike_another_budget(bench):
    b = bench()
    b.models["large"].ms, perception = 60.0, b.config.perception
    b.until(lambda: b.shedder.level == 1)
    swap = perception.swap.model_copy(update={"budget_ms": 100.0})
    b.shedder.reconfigure(perception.model_copy(update={"swap": swap}))
    assert b.shedder.level == 1
    detector = perception.detector.model_copy(update={"model": "small"})
    b.shedder.reconfigure(perception.model_copy(update={"detector": detector}))
    assert (b.shedder.level, b.shedder.status()["state"]) == (0, "steady")


def service(lockstep: bool, **load_shedding) -> ClosedLoop:
    choice = {"kind": "text", "url": "http://127.0.0.1:1/v1", "model": "m"}
    return ClosedLoop(simulated({
        "loop": {"lockstep": lockstep}, "mission": {"target": "bed"},
        "perception": {"choice": choice, "load_shedding": load_shedding},
    }))  # fmt: skip


@pytest.mark.parametrize(
    ("lockstep", "levels"), [(False, []), (True, LEVELS[1:])], ids=["no levels", "lockstep"]
)
def test_lockstep_or_no_levels_disable_the_load_shedder(lockstep, levels):
    closed = service(lockstep, levels=levels)
    assert closed.service.load_shedder is None
    assert status_message(closed.service.result())["load_shedding"] is None


def test_each_step_is_in_the_status_and_the_events():
    closed = service(False, levels=LEVELS[1:])
    shedder = closed.service.load_shedder
    try:
        shedder._board._work = lambda _: HOT
        s = iter(range(10_000))
        eventually(lambda: shedder.step(next(s) * 10**9) or shedder.level == 1)
        closed.step()
        status = status_message(closed.service.result())
        assert closed.service.perception.scorers.shed == {"choice"}
    finally:
        closed.close()
    assert (status["load_shedding"]["level"], status["load_shedding"]["steps"]["down"]) == (1, 1)
    texts = [text for text in closed.notes.events if text.startswith("load shedding")]
    assert texts == [f"load shedding: {status['load_shedding']['why']}"]
    assert "pause choice: tj is at 97 C" in texts[0]


def test_levels_name_models_that_are_here():
    with pytest.raises(ModelError, match=r"^model 'none': no such card"):
        module._check_model_is_here("none")
    with pytest.raises(
        ModelError, match=r"480x640-fp32 of perception\.load_shedding\.levels is not"
    ):
        module._check_model_is_here("yolo-world-s-480x640-fp32")
