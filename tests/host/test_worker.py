"""Background worker: submit never blocks, the newest item wins, queued items keep their order."""

from __future__ import annotations

import itertools
import logging
import threading

import pytest
from patience import PATIENCE_S, eventually

from edge.errors import UserError
from edge.host import worker as host
from edge.host.worker import LONGEST_ERROR, MAX_DOUBLINGS, MAX_PAUSE_S, Worker


class Gate:
    """Work that waits until the test lets it go; returns its item, or raises it."""

    def __init__(self) -> None:
        self.open, self.entered = threading.Event(), threading.Event()
        self.got: list[object] = []

    def __call__(self, item: object) -> object:
        self.entered.set()
        assert self.open.wait(PATIENCE_S)
        self.got.append(item)
        if isinstance(item, Exception):
            raise item
        return item


@pytest.fixture
def gate():
    gate = Gate()
    yield gate
    gate.open.set()


def stuck(gate: Gate, **options) -> Worker:
    """Return a worker whose thread hangs at its first item."""
    worker = Worker("test", gate, **options)
    worker.submit("first")
    assert gate.entered.wait(PATIENCE_S)
    return worker


@pytest.mark.parametrize("inline", [False, True])
def test_nothing_submitted_nothing_done(inline):
    got: list = []
    worker = Worker("test", got.append, inline=inline)
    assert worker.idle
    assert worker.poll() is None
    assert worker.close(PATIENCE_S)
    assert worker.close(PATIENCE_S)
    assert (got, worker.stats) == ([], host.WorkerStats())


def test_discard_all_drops_submitted_items_and_results(gate):
    dropped, unread = [], []
    worker = stuck(gate, drop=dropped.append, drop_result=unread.append)
    worker.submit("waits")
    worker.discard_all()
    assert dropped == ["waits"]
    gate.open.set()
    eventually(lambda: worker.idle)
    assert (unread, worker.poll()) == (["first"], None)
    worker.submit("unread")
    eventually(lambda: worker.idle)
    worker.discard_all()
    assert (unread, worker.poll()) == (["first", "unread"], None)
    worker.submit("after")
    assert eventually(worker.poll) == "after"
    worker.close()


def test_the_newest_item_and_result_win(gate):
    dropped, unread = [], []
    worker = stuck(gate, drop=dropped.append, drop_result=unread.append)
    for item in "abc":
        worker.submit(item)
    assert dropped == ["a", "b"]
    assert not worker.idle
    gate.open.set()
    eventually(lambda: worker.idle)
    assert unread == ["first"]
    assert (worker.poll(), worker.poll()) == ("c", None)
    stats = worker.stats
    assert (stats.submitted, stats.replaced, stats.done, stats.results_replaced) == (4, 2, 2, 1)
    assert stats.last_latency_ns > 0
    worker.close()
    worker.submit("late")
    assert dropped == ["a", "b", "late"]


def test_the_newest_of_a_key_wins_in_queue_order(gate):
    worker = stuck(gate, finish_on_close=True)
    worker.submit("map 1", key="map")
    worker.enqueue("tick 1")
    worker.submit("status 1", key="status")
    worker.submit("map 2", key="map")
    worker.enqueue("tick 2")
    gate.open.set()
    assert worker.close(PATIENCE_S)
    assert gate.got == ["first", "map 2", "tick 1", "status 1", "tick 2"]


def test_the_queue_is_bounded_and_the_newest_stay(gate, monkeypatch):
    monkeypatch.setattr(host, "MOST_QUEUED", 3)
    dropped: list = []
    worker = stuck(gate, finish_on_close=True, drop=dropped.append)
    worker.submit("map", key="map")
    for n in range(5):
        worker.enqueue(n)
    assert (dropped, worker.stats.replaced) == ([0, 1], 2)
    gate.open.set()
    assert worker.close(PATIENCE_S)
    assert gate.got == ["first", "map", 2, 3, 4]


def test_closing_drops_queued_items_within_its_time_limit(gate):
    dropped, unread = [], []
    worker = stuck(gate, drop=dropped.append, drop_result=unread.append)
    worker.submit("waiting")
    assert not worker.close(0.01)
    assert (dropped, unread) == (["waiting"], [])
    gate.open.set()
    assert worker.close(PATIENCE_S)
    assert (gate.got, unread) == (["first"], ["first"])
    assert worker.poll() is None


def test_failures_are_survived_and_logged_once_per_kind(caplog):
    done: list = []

    def work(item):
        done.append(item)
        if isinstance(item, Exception):
            raise item
        return item

    worker, rows = Worker("test", work, inline=True), []
    errors = [RuntimeError("no\nluck"), RuntimeError(), ValueError("x" * 1000)]
    for item in [*errors, "well", UserError("say what"), RuntimeError()]:
        before = worker.stats.failures
        kept = dict(before)
        worker.submit(item)
        assert before == kept  # a dict that someone reads is never changed
        rows.append(worker.stats.in_a_row)
        assert len(worker.stats.last_error) <= LONGEST_ERROR
    assert rows == [1, 2, 3, 0, 1, 2]
    assert worker.stats.failures == {"RuntimeError": 3, "ValueError": 1, "UserError": 1}
    assert (worker.stats.failed, worker.stats.done, worker.poll()) == (5, 1, "well")
    assert [r.levelno for r in caplog.records] == [logging.ERROR] * 3
    assert caplog.messages[0] == "test: RuntimeError: no luck (more of these are only counted)"
    assert caplog.messages[2] == "test: say what (more of these are only counted)"


def test_inline_items_go_by_after_a_failure(caplog):
    fails, got = [9], []

    def work(item: int) -> None:
        got.append(item)
        fails[0] -= 1
        if fails[0] >= 0:
            raise RuntimeError("no")

    worker = Worker("test", work, inline=True, pause_s=1.0)
    for n in range(330):
        worker.submit(n)
    assert got[:4] == [0, 3, 8, 17]  # 2, 4, 8 … in between
    assert max(b - a for a, b in itertools.pairwise(got)) == 2**MAX_DOUBLINGS + 1
    assert got[-3:] == [327, 328, 329]
    assert len(caplog.records) == 1
    fails[0] = 1
    worker.submit(330)
    assert len(caplog.records) == 2  # another row


def test_failures_are_followed_by_growing_pauses(gate):
    gate.open.set()
    worker = Worker("test", gate, pause_s=0.5)
    pauses = []
    for n in (0, 1, 2, 3, MAX_DOUBLINGS, 10**6):
        worker.stats.in_a_row = n
        pauses.append(worker._pause_length_s())
    assert pauses == [0.5, 0.5, 1.0, 2.0, 16.0, MAX_PAUSE_S]
    worker._pause_s = 1e9
    worker.submit(RuntimeError("no"))
    eventually(lambda: worker.stats.failed)
    worker.submit("later")
    assert not worker.idle
    worker.close()  # ends the pause
    assert len(gate.got) == 1


def test_the_worker_rests_after_a_result(gate):
    gate.open.set()
    worker = Worker("test", gate, rest_s=3600)
    worker.submit("a")
    assert eventually(worker.poll) == "a"
    worker.submit("b")
    assert not worker.idle
    worker.close()
    assert gate.got == ["a"]


def test_the_periodic_callback_may_fail(caplog):
    beats = threading.Semaphore(0)

    def beat() -> None:
        beats.release()
        raise ValueError("no beat")

    worker = Worker("test", print, periodic=beat)
    for _ in range(3):
        assert beats.acquire(timeout=PATIENCE_S)
    assert worker.close(PATIENCE_S)
    assert caplog.text.count("no beat") == 1
