"""A model that replaces another: refused, rolled back or kept."""

from __future__ import annotations

import contextlib
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from frames import Slot
from patience import PATIENCE_S, eventually
from simulated import simulated

from edge.perception.embedding.text import PromptError
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import WHY_INVALID, ModelHealth
from edge.perception.swap import detector as swapped
from edge.perception.swap.base import SwapError
from edge.perception.swap.detector import DetectorSwap
from edge.perception.swap.trial import TrialImage, boxes_found_again
from edge.perception.worker import DetectorWorker
from edge.types import Detections

BOX = (10.0, 10.0, 30.0, 30.0)
MS = 1_000_000
NAN = float("nan")


class Fake:
    """Fake detector of one box in every image; from image `from_` on it follows `then`."""

    def __init__(self, name="new", words=("chair", "bed"), from_=0, **then):
        self.name, self.words, self.closed, self.images = name, words, 0, 0
        self.prompts: tuple[str, ...] = ("chair",)
        self.invalid_boxes = 0
        self.from_, self.then = from_, then
        self.entered, self.gate = threading.Event(), threading.Event()
        self.gate.set()

    def set_prompts(self, prompts):
        if lacks := [p for p in prompts if p not in self.words]:
            raise PromptError(f"prompt {lacks[0]!r}: not in the vocabulary")
        self.prompts = tuple(prompts)

    def detect(self, observation):
        self.entered.set()
        assert self.gate.wait(PATIENCE_S)
        assert not self.closed
        behaviour = {"box": BOX, "score": 0.6, "ms": 5.0}
        behaviour.update(self.then if self.images >= self.from_ else {})
        self.images += 1
        if "error" in behaviour:
            raise behaviour["error"]
        self.invalid_boxes += behaviour.get("invalid", 0)
        return Detections(
            observation, np.array([behaviour["box"]], np.float32),
            np.array([behaviour["score"]], np.float32), np.zeros(1, np.int32), self.prompts,
            latency_ns=int(behaviour["ms"] * MS),
        )  # fmt: skip

    def health(self):
        return (
            self.then.get("health", ModelHealth()) if self.images >= self.from_ else ModelHealth()
        )

    def close(self):
        self.closed += 1


class Bench:
    """A worker, a swapper, and a loop that steps once for every image."""

    def __init__(self, make_observation, old, new, inline=True, isolation="process", **swap):
        self.clock_s, self.building = 0.0, None
        self.old, self.new, self.said, self.seq = old, new, [], 0
        self.worker = DetectorWorker(old, inline)
        self._make_observation = make_observation
        settings = {"probation": 5, "budget_ms": 20.0, **swap}
        self.swapper = DetectorSwap(
            simulated({"perception": {"swap": settings}}).perception.model_copy(
                update={"isolation": isolation}
            ),
            self.worker,
            lambda text, *_: self.said.append(text), self._make, lambda: self.clock_s,
        )  # fmt: skip

    def _make(self, perception, prompts, progress, cancelled):
        if isinstance(self.new, Exception):
            raise self.new
        if self.building is not None:
            progress(self.building)
        self.new.set_prompts(prompts)
        assert perception.detector.model == "new"
        return self.new

    def frame(self):
        self.seq += 1
        rgb = np.zeros((64, 80, 3), np.uint8)
        return self._make_observation(seq=10 * self.seq, rgb=rgb)

    def image(self):
        """One image through the worker, one step of the loop."""
        self.worker.submit(self.frame())
        eventually(lambda: self.worker.idle)
        found = self.worker.poll()
        self.swapper.step(self.seq)
        return found

    def until(self, *states):
        """Images until the swap is in one of these states."""

        def reached():
            self.image()
            return self.swapper.state in states

        eventually(reached, f"never {states}: {self.swapper.status()}")

    def swap(self, force=False):
        """Run an entire swap; return its outcome."""
        self.swapper.request("new", force, 0)
        self.until("kept", "rolled back", "refused")
        return self.swapper.state, self.swapper.status()["detail"]


@pytest.fixture
def bench(make_observation, monkeypatch):
    monkeypatch.setattr(swapped, "same_family", lambda model, running: True)
    monkeypatch.setattr(swapped, "IMAGES", 2)
    opened = []

    def make(new=None, old=None, **more):
        new = Fake() if new is None else new
        old = Fake("old", words=("chair", "bed", "sofa")) if old is None else old
        opened.append(Bench(make_observation, old, new, **more))
        return opened[-1]

    yield make
    for one in opened:
        one.swapper.close()
        one.worker.close()


@pytest.mark.parametrize("inline", [True, False])
def test_a_good_model_replaces_the_old_one(bench, inline):
    b = bench(inline=inline)
    assert b.swap() == ("kept", "5 images, median 5.0 ms")
    assert b.worker.detector is b.new
    assert b.worker.previous is None
    assert b.worker.on_result is None
    eventually(lambda: b.old.closed)
    assert (b.old.closed, b.new.closed) == (1, 0)
    assert b.said == [
        "model new: loading, old runs",
        "model new: runs now, on probation for 5 images; median 5.0 ms on 2 images; "
        "finds 2 of the 2 boxes of old",
        "model new: kept: 5 images, median 5.0 ms",
    ]
    status = b.swapper.status()
    assert (status["model"], status["previous"], status["number"]) == ("new", "old", 1)
    assert b.swapper.outcomes == {"kept": 1, "rolled back": 0, "refused": 0}


@pytest.mark.parametrize(
    ("new", "reason"),
    [
        (ModelError("new.onnx: damaged\nor another"), "new.onnx: damaged or another"),
        (MemoryError("no room"), "it fails: MemoryError: no room"),
        (Fake(words=("bed",)), "prompt 'chair': not in the vocabulary"),
        (Fake(error=RuntimeError("bad\nnode")), "it fails: RuntimeError: bad node"),
        (Fake(from_=3, error=RuntimeError("bad")), "it fails: RuntimeError: bad"),
        (Fake(invalid=7), f"it returns 7 boxes of an image that are {WHY_INVALID}"),
        (Fake(box=(0, 0, NAN, 9)), "it returns boxes that are not finite"),
        *((Fake(score=score), "it returns scores that are not in 0 to 1")
          for score in (float("inf"), NAN, 1e30, -0.5)),
        (Fake(ms=21), "too slow: median 21.0 ms on 2 images, perception.swap.budget_ms is 20; "
                      "add --force to use it anyway"),
        (Fake(box=(40, 40, 60, 60)), "finds 0 of the 2 boxes of old, fewer than half; add "
                                     "--force to use it anyway"),
        (Fake(score=0.29), "finds 0 of the 2 boxes of old, fewer than half; add --force to use "
                           "it anyway"),
    ],
)  # fmt: skip
def test_a_bad_model_is_refused_before_the_swap(bench, new, reason):
    b = bench(new)
    assert b.swap() == ("refused", f"{reason}; old goes on")
    assert b.said[1:] == [f"model new: refused: {reason}; old goes on"]
    assert b.worker.detector is b.old
    assert b.image() is not None
    b.swapper.close()
    assert b.old.closed == 0


@pytest.mark.parametrize("fails", [True, False])
def test_a_model_is_first_tried_in_a_process(bench, fails):
    """A model that never ends could not be killed in a thread."""
    b, made = bench(isolation="thread"), []
    error = RuntimeError("its process was killed")

    def make(perception, prompts, progress, cancelled):
        apart = perception.isolation == "process"
        made.append(Fake(perception.isolation, **({"error": error} if fails and apart else {})))
        return made[-1]

    b.swapper._make = make
    assert b.swap()[0] == ("refused" if fails else "kept")
    eventually(lambda: made[0].closed)
    assert [one.name for one in made] == ["process"] + ["thread"] * (not fails)
    assert made[0].images == (1 if fails else 2)


@pytest.mark.parametrize(
    ("then", "reason"),
    [
        ({"error": ValueError("no")}, "it fails: ValueError: no"),
        ({"invalid": 1}, f"it returns 1 boxes of an image that are {WHY_INVALID}"),
        ({"box": (NAN, 0, 1, 1)}, "it returns boxes that are not finite"),
        ({"score": 1e30}, "it returns scores that are not in 0 to 1"),
        ({"ms": 30}, "too slow: 5 images, median 30.0 ms, perception.swap.budget_ms is 20"),
        ({"health": ModelHealth("degraded", "ended 8 times")}, "degraded: ended 8 times"),
        ({"health": ModelHealth("restarting", "it ended")}, "restarting: it ended"),
    ],
)
@pytest.mark.parametrize("inline", [True, False])
def test_a_model_that_fails_on_probation_is_rolled_back(bench, then, reason, inline):
    tried = 2 + 3 * 2
    b = bench(Fake(from_=tried + 1, **then), inline=inline)
    assert b.swap() == ("rolled back", f"{reason}; old runs again")
    assert b.worker.detector is b.old
    assert b.worker.previous is None
    eventually(lambda: b.new.closed)
    assert b.old.closed == 0
    seen = b.old.images
    b.image()
    assert b.old.images == seen + 1


@pytest.mark.parametrize("new", [Fake(ms=50), Fake(box=(40, 40, 60, 60)), Fake(score=0.1)])
def test_force_accepts_a_slow_or_different_model(bench, new):
    assert bench(new).swap(force=True)[0] == "kept"


def test_force_rejects_invalid_outputs(bench):
    assert bench(Fake(invalid=1)).swap(force=True)[0] == "refused"
    assert bench(Fake(from_=9, invalid=1)).swap(force=True)[0] == "rolled back"


@pytest.mark.parametrize(
    ("old", "related", "finding"),
    [
        (Fake("old", score=0.2), True, "old found nothing on these images to compare with"),
        (Fake("old", error=RuntimeError("dead")), True,
         "old found nothing on these images to compare with"),
        (Fake("old", box=(50, 0, 60, 9)), False,
         "finds 0 of the 2 boxes of old (another family: no reason to refuse it)"),
    ],
)  # fmt: skip
def test_a_model_without_comparable_boxes_is_kept(bench, monkeypatch, old, related, finding):
    b = bench(old=old)
    monkeypatch.setattr(swapped, "same_family", lambda model, running: related)
    assert b.swap()[0] == "kept"
    assert b.said[1].endswith(f"median 5.0 ms on 2 images; {finding}")


def test_only_one_swap_to_another_model_may_run(bench):
    b = bench()
    with pytest.raises(SwapError, match=r"^model old runs already$"):
        b.swapper.request("old", False, 0)
    b.swapper.request("new", False, 0)
    with pytest.raises(
        SwapError, match=r"^the swap to new is still (loading|checking); wait until it e"
    ):
        b.swapper.request("other", False, 0)
    b.until("on probation")
    with pytest.raises(SwapError, match=r"^the swap to new is still on probation"):
        b.swapper.request("old", False, 0)
    b.until("kept")
    b.new = Fake(ms=99)
    with pytest.raises(SwapError, match=r"^model new runs already$"):
        b.swapper.request("new", False, 0)


def test_no_images_no_swap_and_the_wait_for_them_ends(bench, monkeypatch):
    monkeypatch.setattr("edge.perception.swap.base.LOAD_TIMEOUT_S", 9.0)
    b = bench()
    b.swapper.request("new", False, 0)
    eventually(lambda: b.swapper.state == "checking")
    b.swapper.step(0)
    assert b.swapper.status()["progress"] == "0 of 2 images collected"
    b.clock_s = 9.5
    b.swapper.step(0)
    assert b.swapper.state == "refused"
    assert b.said[-1] == ("model new: refused: 0 of 2 images collected after 9 s; old goes on")
    eventually(lambda: b.new.closed)


def test_a_probation_without_images_ends(bench):
    b = bench()
    b.swapper.request("new", False, 0)
    b.until("on probation")
    start_ns = 10**9
    for at_s, state in ((0, "on probation"), (59, "on probation"), (61, "rolled back")):
        b.swapper.step(start_ns + at_s * 10**9)
        assert b.swapper.state == state
    assert b.said[-1] == "model new: rolled back: no images for 60 s; old runs again"
    assert b.worker.detector is b.old


@pytest.mark.parametrize("gap_s", [59, 30])
def test_a_probation_with_rare_images_goes_on(bench, gap_s):
    b = bench()
    b.swapper.request("new", False, 0)
    b.until("on probation")
    now_ns = b.seq
    while b.swapper.state == "on probation":
        b.worker.submit(b.frame())
        eventually(lambda: b.worker.idle)
        b.swapper.step(now_ns)
        now_ns += gap_s * 10**9
    assert b.swapper.state == "kept"


def test_observations_without_an_image_are_not_held_against_a_model(bench, make_observation):
    b = bench()
    b.swapper.request("new", False, 0)
    b.until("on probation")
    for _ in range(20):
        b.worker.on_result(b.new, make_observation(), ValueError("no image to detect in"))
        b.swapper.step(0)
    assert b.swapper.state == "on probation"


class Slow(Fake):
    """Is made only when `go` is set."""

    def __init__(self, **more):
        super().__init__(**more)
        self.begun, self.go = threading.Event(), threading.Event()

    def set_prompts(self, prompts):
        self.begun.set()
        assert self.go.wait(PATIENCE_S)
        super().set_prompts(prompts)


def test_the_build_of_an_engine_is_reported(bench):
    b = bench(Slow())
    b.building = ModelHealth("building engine", "40 s")
    b.swapper.request("new", False, 0)
    assert b.new.begun.wait(PATIENCE_S)
    status = b.swapper.status()
    assert (status["state"], status["detail"]) == ("loading", "building engine: 40 s")
    b.new.go.set()
    b.until("on probation")
    assert "building" not in b.swapper.status()["detail"]


def test_changed_prompts_reach_a_loaded_model(bench):
    b = bench()
    b.swapper.request("new", False, 0)

    def is_ready():  # the loop does not step meanwhile
        b.worker.submit(b.frame())
        return b.swapper._attempt.finding

    eventually(is_ready)
    b.worker.set_prompts(["bed"])
    b.until("on probation")
    assert b.new.prompts == ("bed",)


def test_a_model_without_the_new_prompts_is_refused(bench):
    b = bench(Slow())
    b.swapper.request("new", False, 0)
    assert b.new.begun.wait(PATIENCE_S)
    b.worker.set_prompts(["sofa"])
    b.new.go.set()
    b.until("refused")
    assert b.said[-1] == "model new: refused: prompt 'sofa': not in the vocabulary; old goes on"
    assert b.old.prompts == ("sofa",)


def test_prompts_that_change_on_probation_reach_both(bench):
    b = bench(Fake(words=("chair", "bed", "desk"), from_=11, error=RuntimeError("late")))
    b.swapper.request("new", False, 0)
    b.until("on probation")
    for prompts, line in (
        (["sofa"], r"^prompt 'sofa': not in the vocabulary$"),
        (["desk"], r"^model old, kept until new passes .*: prompt 'desk': .*; try again after"),
    ):
        with pytest.raises(PromptError, match=line):
            b.worker.set_prompts(prompts)
        assert b.new.prompts == b.old.prompts == ("chair",)
    b.worker.set_prompts(["bed"])
    assert b.new.prompts == b.old.prompts == ("bed",)
    b.until("rolled back")
    assert b.worker.detector.prompts == ("bed",)


@pytest.mark.parametrize("broken", ["old", "new"])
def test_prompts_change_in_both_models_or_neither(bench, monkeypatch, broken):
    b = bench()
    b.swapper.request("new", False, 0)
    b.until("on probation")

    def fail(prompts):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(getattr(b, broken), "set_prompts", fail)
    with pytest.raises(RuntimeError, match="out of memory"):
        b.worker.set_prompts(["bed"])
    assert b.new.prompts == b.old.prompts == ("chair",)


def test_an_image_that_cannot_be_copied_refuses_the_model(bench, monkeypatch):
    def fail(*_):
        raise MemoryError("12 MB")

    monkeypatch.setattr(swapped, "sample", fail)
    b = bench(inline=False)
    assert b.swap() == ("refused", "it cannot be watched: MemoryError: 12 MB; old goes on")
    assert b.image() is not None


def test_a_refused_loading_model_blocks_the_next_swap(bench, monkeypatch):
    monkeypatch.setattr("edge.perception.swap.base.LOAD_TIMEOUT_S", 9.0)
    b = bench(Slow())
    b.swapper.request("new", False, 0)
    assert b.new.begun.wait(PATIENCE_S)
    b.image()
    b.image()
    b.clock_s = 9.5
    b.swapper.step(0)
    assert b.swapper.state == "refused"
    with pytest.raises(SwapError, match=r"^model new, which was refused, is still loading; try ag"):
        b.swapper.request("new", False, 0)
    b.new.go.set()
    eventually(lambda: b.new.closed)
    assert b.new.images == 0
    b.new = Fake()

    def is_taken():
        with contextlib.suppress(SwapError):
            b.swapper.request("new", False, 0)
        return b.swapper.state != "refused"

    eventually(is_taken)
    b.until("kept")


def test_closing_does_not_wait_for_a_loading_model(bench, monkeypatch):
    monkeypatch.setattr("edge.perception.swap.base.CLOSE_S", 0.01)
    b = bench(Slow())
    b.swapper.request("new", False, 0)
    assert b.new.begun.wait(PATIENCE_S)
    b.swapper.close()
    assert b.worker.on_result is None
    assert b.new.closed == 0
    b.new.go.set()
    eventually(lambda: b.new.closed)
    assert b.old.closed == 0


def test_closing_on_probation_closes_both(bench):
    b = bench()
    b.swapper.request("new", False, 0)
    b.until("on probation")
    b.swapper.close()
    b.worker.close()
    assert (b.old.closed, b.new.closed) == (1, 1)


def test_a_busy_detector_is_closed_after_its_image(bench):
    b = bench(inline=False)
    b.swapper.request("new", False, 0)
    b.until("on probation")
    b.new.gate.clear()
    b.new.entered.clear()
    b.worker.submit(b.frame())
    assert b.new.entered.wait(PATIENCE_S)
    b.new.then = {"health": ModelHealth("degraded", "")}
    b.swapper.step(0)
    assert b.swapper.state == "rolled back"
    assert b.worker.uses(b.new)
    b.new.gate.set()
    eventually(lambda: b.new.closed)
    assert b.worker.stats.failed == 0


def test_the_exchange_while_the_old_one_detects(make_observation):
    """Its result still counts, its observation is let go, and it is in use until then."""
    old, new = Fake("old"), Fake("new")
    worker = DetectorWorker(old)
    old.gate.clear()
    frames = [
        make_observation(seq=i, rgb=np.zeros((4, 4, 3), np.uint8), slot=Slot()) for i in range(2)
    ]
    worker.submit(frames[0])
    assert old.entered.wait(PATIENCE_S)
    assert worker.exchange(new) is old
    assert worker.uses(old)
    worker.submit(frames[1])
    assert new.images == 0
    old.gate.set()
    eventually(lambda: worker.stats.done == 2)
    assert not worker.uses(old)
    assert (old.images, new.images) == (1, 1)
    worker.close()
    assert [f.slot.holds for f in frames] == [0, 0]
    assert (old.closed, new.closed) == (0, 1)


# -- boxes found again ---------------------------------------------------------------------------


def detections(boxes, scores, classes, competing_score=None, prompts=("chair", "bed")):
    return Detections(
        SimpleNamespace(), np.array(boxes, np.float32).reshape(-1, 4),
        np.array(scores, np.float32), np.array(classes, np.int32), prompts,
        competing_score=None if competing_score is None else np.array(competing_score, np.float32),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("was", "now", "expected"),
    [
        (detections([], [], []), detections([], [], []), (0, 0)),
        (detections([], [], []), detections([BOX], [0.9], [0]), (0, 0)),
        (detections([BOX], [0.9], [0]), detections([], [], []), (1, 0)),
        (detections([BOX], [0.9], [0]), detections([BOX], [0.45], [0]), (1, 1)),
        (detections([BOX], [0.9], [0]), detections([BOX], [0.44], [0]), (1, 0)),
        (detections([BOX], [0.9], [0]), detections([BOX], [0.9], [1]), (1, 0)),
        (detections([BOX], [0.29], [0]), detections([BOX], [0.9], [0]), (0, 0)),
        (detections([BOX], [0.9], [0], competing_score=[0.95]), detections([], [], []), (0, 0)),
        (detections([BOX], [0.9], [0]), detections([BOX], [0.9], [0], prompts=("bed",)), (0, 0)),
        (detections([BOX, BOX], [0.9, 0.8], [0, 1]), detections([BOX], [0.9], [1]), (2, 1)),
    ],
)
def test_boxes_found_again_are_counted(was, now, expected):
    assert boxes_found_again([TrialImage(SimpleNamespace(), was)], [now], 0.3) == expected
