"""Who posts never waits; the newest wins; what is queued keeps its order."""

from __future__ import annotations

import threading

import pytest
from patience import PATIENCE_S

from edge.host.mailbox import Mailbox


class Gate:
    """A delivery that waits until the test lets it go."""

    def __init__(self) -> None:
        self.open, self.entered = threading.Event(), threading.Event()
        self.got: list[tuple[str, object]] = []

    def __call__(self, name: str, item: object) -> None:
        self.entered.set()
        assert self.open.wait(PATIENCE_S)
        self.got.append((name, item))


@pytest.fixture
def gate():
    gate = Gate()
    yield gate
    gate.open.set()


def stuck(gate: Gate, **options) -> Mailbox:
    """A mailbox whose thread hangs in the delivery of a first item."""
    box = Mailbox("test", gate, **options)
    box.post("first", 0)
    assert gate.entered.wait(PATIENCE_S)
    return box


def test_nothing_posted_nothing_delivered():
    got = []
    assert Mailbox("test", lambda *item: got.append(item)).close(PATIENCE_S)
    assert got == []


def test_the_newest_of_a_name_wins_and_queued_items_all_leave_in_order(gate):
    box = stuck(gate)
    box.post("map", 1)
    box.queue("tick", 1)
    box.post("status", 1)
    box.post("map", 2)
    box.queue("tick", 2)
    assert box.replaced == 1
    gate.open.set()
    assert box.close(PATIENCE_S)
    expected = [("map", 2), ("tick", 1), ("status", 1), ("tick", 2)]
    assert gate.got == [("first", 0), *expected]


def test_the_queue_is_bounded_and_the_newest_stay(gate):
    box = stuck(gate, capacity=3)
    for i in range(5):
        box.queue("tick", i)
    assert box.overflowed == 2
    gate.open.set()
    assert box.close(PATIENCE_S)
    assert gate.got == [("first", 0), ("tick", 2), ("tick", 3), ("tick", 4)]


def test_closing_does_not_wait_for_a_delivery_that_hangs(gate):
    box = stuck(gate)
    assert not box.close(0.01)


def test_a_delivery_that_raises_is_counted_and_the_next_goes_on(caplog):
    got = []

    def deliver(name, item):
        if item == "bad":
            raise ValueError("cannot be sent")
        got.append(item)

    box = Mailbox("test", deliver)
    for item in ("bad", "good", "bad"):
        box.queue("x", item)
    assert box.close(PATIENCE_S)
    assert (got, box.failed) == (["good"], 2)
    assert caplog.text.count("cannot be sent") == 1


def test_idle_is_called_while_nothing_comes():
    called = threading.Event()
    box = Mailbox("test", lambda *_: None, called.set, period_s=0.001)
    assert called.wait(PATIENCE_S)
    assert box.close(PATIENCE_S)
