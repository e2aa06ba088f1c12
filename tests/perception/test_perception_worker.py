"""Models in the background: no frame is held longer than needed."""

from __future__ import annotations

import threading
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from frames import Slot
from patience import PATIENCE_S, eventually

from edge.chat import ChatError
from edge.host import worker as host
from edge.perception.runtime.health import ModelHealth
from edge.perception.worker import DetectorWorker, ScorerWorker
from edge.types import Detections, Observation


class Fake:
    """Finds one box; waits for `gate` before each image, fails on the seqs in `bad`."""

    name = "fake"
    prompts = ("chair",)
    own = ModelHealth()

    def __init__(self, bad=()):
        self.gate = threading.Semaphore(0)
        self.started = threading.Semaphore(0)
        self.bad = bad
        self.closed = False

    def detect(self, observation):
        self.started.release()
        assert self.gate.acquire(timeout=PATIENCE_S)
        if observation.seq in self.bad:
            raise RuntimeError(f"no luck\nwith {observation.seq}")
        return found_in(observation)

    def health(self):
        return self.own

    def close(self):
        self.closed = True


def found_in(observation):
    one = np.ones(1, np.float32)
    return Detections(observation, np.zeros((1, 4), np.float32), one, one.astype(np.int32), ("a",))


@pytest.fixture
def frames(make_observation):
    rgb = np.zeros((1, 1, 3), np.uint8)
    return [make_observation(seq=i, slot=Slot(), rgb=rgb) for i in range(5)]


def holds(frames):
    return [frame.slot.holds for frame in frames]


def test_the_newest_waiting_image_wins(frames):
    worker = DetectorWorker(fake := Fake())
    worker.submit(frames[0])
    assert fake.started.acquire(timeout=PATIENCE_S)
    for frame in frames[1:4]:
        worker.submit(frame)
    assert holds(frames) == [1, 0, 0, 1, 0]
    fake.gate.release(2)
    eventually(lambda: worker.idle)
    assert holds(frames) == [0, 0, 0, 1, 0]
    found = worker.poll()
    assert found.observation is frames[3]
    worker.close()
    assert holds(frames) == [0, 0, 0, 1, 0]  # held by the caller of poll
    assert fake.closed


def test_cameras_take_turns(make_observation):
    """Two ticks pass while the detector runs, so the newest image is always of camera 0."""
    rgb = np.zeros((1, 1, 3), np.uint8)
    seen = [make_observation(seq=i, slot=Slot(), rgb=rgb, camera_index=i % 2) for i in range(12)]
    worker, found = DetectorWorker(fake := Fake()), []
    for newer in (seen[:1], seen[1:3], seen[3:5], seen[5:7], seen[7:9], seen[9:11]):
        for observation in newer:
            worker.submit(observation)
        assert fake.started.acquire(timeout=PATIENCE_S)
        fake.gate.release()
        done = len(found) + 1
        eventually(lambda done=done: worker.stats.done == done)
        found.append(worker.poll().observation)
        found[-1].release()
    assert [o.camera_index for o in found] == [0, 1, 0, 1, 0, 1]
    assert [o.seq for o in found] == sorted(o.seq for o in found)
    fake.gate.release()  # for the image that still waits
    worker.close()
    assert holds(seen) == [0] * len(seen)


@pytest.mark.parametrize("inline", [False, True])
def test_failures_in_a_row_end_with_a_result(frames, inline, caplog):
    worker, rows = DetectorWorker(fake := Fake(bad=(0, 1, 3)), inline), []
    fake.gate.release(len(frames))
    for frame in frames:
        fake.own = ModelHealth("restarting", "it ended") if frame.seq == 1 else ModelHealth()
        worker.submit(frame)
        eventually(lambda: worker.idle)
        rows.append(worker.stats.in_a_row)
    assert rows == [1, 1, 0, 1, 0]
    assert worker.stats.failed == 3
    assert caplog.messages == [
        "detector fake: RuntimeError: no luck with 0 (more of these are only counted)"
    ]
    assert worker.poll().observation is frames[4]
    worker.close()


@pytest.mark.parametrize("looks_at", ["rgb", "depth_m"])
@pytest.mark.parametrize("inline", [False, True])
def test_an_observation_without_an_image_is_no_failure(make_observation, looks_at, inline):
    """A LiDAR maps at 10 Hz next to a camera of 5 Hz."""
    fake = Fake(bad=(0, 2))
    fake.looks_at = looks_at
    worker = DetectorWorker(fake, inline)
    sweeps = [make_observation(seq=i, slot=Slot(), cloud_m=np.ones((1, 3))) for i in (0, 1, 2)]
    pictured = make_observation(seq=3, slot=Slot(), **{looks_at: np.zeros((1, 1, 3))})
    fake.gate.release(4)
    for frame in (*sweeps, pictured):
        worker.submit(frame)
        eventually(lambda: worker.idle)
    assert (worker.stats.submitted, worker.stats.failed) == (1, 0)
    assert worker.poll().observation is pictured
    worker.close()
    assert holds(sweeps) == [0] * 3


@pytest.mark.parametrize("inline", [False, True])
def test_a_callback_that_fails_stops_nothing(frames, inline, caplog):
    worker = DetectorWorker(fake := Fake(), inline)

    def watch(detector, observation, outcome):
        assert observation.slot.holds == 1
        raise MemoryError("no room for a copy")

    worker.on_result = watch
    for frame in frames[:2]:
        fake.gate.release()
        worker.submit(frame)
        eventually(lambda: worker.idle)
    assert worker.stats.done == 2
    assert "no room for a copy" in caplog.text
    worker.close()
    assert holds(frames) == [0] * 5


class StoodStill:
    """In the place of a thread: the test does its steps."""

    def __init__(self, target, **_):
        self.run = target

    def start(self): ...

    def join(self, timeout=None):
        self.run()  # to its end, once the worker is closed

    def is_alive(self):
        return False


class Steered:
    """A detector or scorer that the test steers while it works."""

    name = "steered"

    def __init__(self):
        self.meanwhile = lambda: None
        self.fails = False

    def detect(self, observation):
        self.meanwhile()
        if self.fails:
            raise RuntimeError("as told")
        return found_in(observation)

    def prepare(self, question):
        return self.detect(question.observation)

    def answer(self, looked):
        return looked

    def health(self):
        return ModelHealth()

    def close(self): ...


class Question(NamedTuple):
    observation: Observation


def stop(worker):
    """Call `close` while its thread is working."""
    worker.stop()
    if (found := worker.poll()) is not None:
        found.observation.release()


@pytest.mark.parametrize("inline", [False, True])
@pytest.mark.parametrize("kind", ["detector", "scorer"])
def test_no_frame_stays_held_in_any_order_of_events(make_observation, monkeypatch, inline, kind):
    """Run all orders of five events: frames, work, failures, close, poll.

    Inline, a new frame is processed at once.
    """
    monkeypatch.setattr(host.threading, "Thread", StoodStill)
    frame = make_observation()

    for events in product("sfWCp", repeat=5):
        steered, slots = Steered(), []
        worker = (
            DetectorWorker(steered, inline)
            if kind == "detector"
            else ScorerWorker("test", steered, inline=inline, pause_s=1e-9)
        )

        def submit(worker=worker, slots=slots):
            slots.append(Slot())
            own = Observation(len(slots), 0, frame.T_map_base, slot=slots[-1])
            worker.submit(own if kind == "detector" else Question(own))

        for event in events:
            steered.fails = event == "f"
            steered.meanwhile = {"W": submit, "C": lambda w=worker: stop(w)}.get(event, list)
            if event == "s" or (inline and event == "f"):
                submit()
            elif event == "p":
                if (found := worker.poll()) is not None and kind == "detector":
                    found.observation.release()
            elif worker._waiting:
                for item in worker._take():
                    worker._process(item)
        worker.close()
        assert [slot.holds for slot in slots] == [0] * len(slots), events


class FakeScorer:
    """Answers with the seq; waits for `gate` before that, until it is closed."""

    name = "fake"

    def __init__(self, *outcomes):
        self.gate = threading.Semaphore(0)
        self.under_way = self.most = 0
        self.closed = threading.Event()
        self.outcomes = list(outcomes)

    def prepare(self, question):
        assert question.observation.slot.holds == 1
        return question.observation.seq

    def answer(self, looked):
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        while not self.gate.acquire(timeout=0.01):
            if self.closed.is_set():
                raise ChatError("given up")
        self.under_way -= 1
        return looked

    def close(self):
        self.closed.set()


def test_the_worker_asks_one_question_at_a_time(frames):
    questions = [Question(frame) for frame in frames]
    worker = ScorerWorker("choice", fake := FakeScorer())
    worker.submit(questions[1])
    assert not worker.idle
    worker.submit(questions[2])
    eventually(lambda: fake.under_way)
    assert holds(frames) == [0] * 5
    worker.submit(questions[3])
    fake.gate.release()
    eventually(lambda: worker.idle)
    assert (worker.poll(), worker.poll()) == ((questions[1], 1), None)
    worker.submit(questions[4])
    fake.gate.release()
    assert eventually(worker.poll) == (questions[4], 4)
    worker.close()
    assert fake.most == 1
    counts = worker.counts()
    assert (counts["model"], counts["asked"], counts["answered"]) == ("fake", 2, 2)
    assert holds(frames) == [0] * 5


def test_closing_discards_a_running_question_without_a_failure(frames, caplog):
    worker = ScorerWorker("choice", fake := FakeScorer())
    worker.submit(Question(frames[0]))
    eventually(lambda: fake.under_way)
    worker.close()
    worker.submit(Question(frames[1]))
    assert (worker.poll(), worker.stats.failed) == (None, 0)
    assert holds(frames) == [0] * 5
    assert not caplog.records
