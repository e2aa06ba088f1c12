from __future__ import annotations

import logging
import threading

import numpy as np
import pytest
from frames import Slot
from patience import PATIENCE_S

from edge.perception.detector import Health
from edge.perception.inline import InlineWorker
from edge.perception.worker import LONGEST_ERROR, DetectorWorker, WorkerStats
from edge.types import Detections


class Fake:
    """Finds one box; waits for `gate` before each image, fails on the seqs in `bad`."""

    name = "fake"
    prompts = ("chair",)
    boxes = 1
    own = Health()

    def __init__(self, bad=()):
        self.gate = threading.Semaphore(0)
        self.started = threading.Semaphore(0)
        self.bad = bad
        self.closed = False

    def set_prompts(self, prompts):
        self.prompts = tuple(prompts)

    def detect(self, observation):
        self.started.release()
        assert self.gate.acquire(timeout=PATIENCE_S)
        if observation.seq in self.bad:
            raise RuntimeError(f"no luck\nwith {observation.seq}")
        one = np.ones(self.boxes, np.float32)
        return Detections(
            observation, np.zeros((self.boxes, 4), np.float32), one, one.astype(np.int32),
            self.prompts,
            latency_ns=7,
        )  # fmt: skip

    def health(self):
        return self.own

    def close(self):
        self.closed = True


@pytest.fixture
def frames(make_observation):
    return [make_observation(seq=i, slot=Slot()) for i in range(5)]


def wait_for(worker, condition):
    """Until the worker has got so far; it always does, or the test times out."""
    pause = threading.Event()
    while not condition():
        assert worker._thread.is_alive()
        pause.wait(0.001)


def test_nothing_submitted_nothing_found():
    worker = DetectorWorker(Fake())
    assert worker.poll() is None
    assert worker.idle()
    worker.close()
    assert worker.detector.closed


def test_the_newest_waiting_image_wins_and_the_others_are_let_go(frames):
    worker = DetectorWorker(fake := Fake())
    worker.submit(frames[0])
    assert fake.started.acquire(timeout=PATIENCE_S)
    for frame in frames[1:4]:
        worker.submit(frame)
    assert [f.slot.holds for f in frames] == [1, 0, 0, 1, 0]
    assert worker.stats.replaced == 2
    fake.gate.release(2)
    wait_for(worker, worker.idle)
    found = worker.poll()
    assert found.observation is frames[3]
    assert worker.stats.done == 2
    assert worker.stats.unread == 1
    assert worker.stats.last_latency_ns == 7
    assert [f.slot.holds for f in frames] == [0, 0, 0, 1, 0]
    assert worker.poll() is None
    found.observation.release()
    worker.close()


def test_a_failure_is_counted_told_once_and_outlived(frames, caplog):
    worker = DetectorWorker(fake := Fake(bad=(0, 1)))
    with caplog.at_level(logging.ERROR):
        for frame in frames[:3]:
            worker.submit(frame)
            fake.gate.release()
            wait_for(worker, worker.idle)
    assert worker.stats.failed == 2
    assert worker.stats.failures == {"RuntimeError": 2}
    assert "no luck with 1" in worker.stats.last_error
    (told,) = (record.getMessage() for record in caplog.records)
    assert told.startswith("detector fake: RuntimeError: no luck with 0 (")
    assert worker.poll().observation is frames[2]
    assert [f.slot.holds for f in frames[:3]] == [0, 0, 1]
    worker.close()


def test_a_failure_is_one_bounded_line_and_counts_that_are_read_stay_as_they_are():
    stats = WorkerStats()
    before = stats.failures
    assert stats.count_failure(RuntimeError("no\nluck " + "x" * 1000))
    assert not stats.count_failure(RuntimeError())
    assert (before, stats.failures) == ({}, {"RuntimeError": 2})
    stats.count_failure(ValueError("no\nluck " + "x" * 1000))
    assert stats.last_error.startswith("ValueError: no luck xxx")
    assert len(stats.last_error) == LONGEST_ERROR


def test_inline_a_failure_is_counted_told_once_a_kind_and_outlived(frames, caplog):
    worker = InlineWorker(fake := Fake(bad=(0, 1)))
    fake.gate.release(len(frames))
    with caplog.at_level(logging.ERROR):
        for frame in frames[:2]:
            worker.submit(frame)
        fake.detect, detect = lambda observation: [][observation.seq], fake.detect
        worker.submit(frames[2])
        fake.detect = detect
        worker.submit(frames[3])
    assert worker.stats.failures == {"RuntimeError": 2, "IndexError": 1}
    assert (worker.stats.failed, worker.stats.done) == (3, 1)
    assert worker.stats.last_error.startswith("IndexError: ")
    assert [r.getMessage().split(":")[1].strip() for r in caplog.records] == [
        "RuntimeError",
        "IndexError",
    ]
    assert worker.poll().observation is frames[3]
    assert [f.slot.holds for f in frames[:4]] == [0, 0, 0, 1]
    worker.close()


@pytest.mark.parametrize("make", [InlineWorker, DetectorWorker])
def test_a_row_of_failures_ends_with_a_result_and_counts_none_of_a_detector_that_is_down(
    frames, make
):
    worker, rows = make(fake := Fake(bad=(0, 1, 3))), []
    fake.gate.release(len(frames))
    for frame in frames:
        fake.own = Health("restarting", "it ended") if frame.seq == 1 else Health()
        worker.submit(frame)
        if make is DetectorWorker:
            wait_for(worker, worker.idle)
        rows.append(worker.stats.in_a_row)
    assert rows == [1, 1, 0, 1, 0]
    assert worker.stats.failed == 3
    worker.close()


@pytest.mark.parametrize("make", [InlineWorker, DetectorWorker])
def test_whoever_watches_and_fails_stops_nothing(frames, make, caplog):
    worker = make(fake := Fake())

    def watch(*_):
        raise MemoryError("no room for a copy")

    worker.watch = watch
    for frame in frames[:2]:
        fake.gate.release()
        worker.submit(frame)
        if make is DetectorWorker:
            wait_for(worker, worker.idle)
    assert worker.stats.done == 2
    assert "no room for a copy" in caplog.text
    assert worker.poll().observation is frames[1]
    assert [f.slot.holds for f in frames[:2]] == [0, 1]
    worker.close()


@pytest.mark.parametrize("boxes", [0, 1])
def test_close_lets_everything_go(frames, boxes):
    worker = DetectorWorker(fake := Fake())
    fake.boxes = boxes
    worker.submit(frames[0])
    fake.gate.release()
    wait_for(worker, worker.idle)
    worker.submit(frames[1])
    assert fake.started.acquire(timeout=PATIENCE_S)
    assert fake.started.acquire(timeout=PATIENCE_S)
    worker.submit(frames[2])
    fake.gate.release()
    worker.close()
    worker.submit(frames[3])
    assert [f.slot.holds for f in frames] == [0] * 5
