"""Another model that chooses directions in the running service."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from patience import eventually

from edge.errors import UserError
from edge.perception.swap.base import SwapError
from edge.perception.swap.choice import CARD_KEY, PROBATION, ChoiceSwap
from edge.perception.worker import ScorerWorker
from edge.types import Observation


class Named:
    """Answers with its name, once `go` is set, or fails with `error`."""

    def __init__(self, name):
        self.name, self.go, self.asked, self.closed = name, threading.Event(), threading.Event(), 0
        self.go.set()
        self.error = None

    def prepare(self, question):
        return question

    def answer(self, looked):
        self.asked.set()
        self.go.wait()
        if self.error is not None:
            raise self.error
        return self.name

    def close(self):
        self.closed += 1


class Question:
    def __init__(self, rgb=True):
        self.observation = Observation(
            0, 0, None, rgb=np.zeros((2, 2, 3), np.uint8) if rgb else None
        )


@pytest.fixture
def swapping(monkeypatch):
    """Return (swap, worker, old, give); a model is loaded when `give` names it."""
    monkeypatch.setattr("edge.perception.swap.base.CLOSE_S", 0.01)
    made = {}
    ready = threading.Condition()

    def make(name):
        with ready:
            ready.wait_for(lambda: name in made)
        if isinstance(made[name], Exception):
            raise made[name]
        return made[name]

    def give(name, what):
        with ready:
            made[name] = what
            ready.notify_all()
        return what

    old = Named("old")
    worker = ScorerWorker("choice", old, pause_s=0.0)
    swap = ChoiceSwap(worker, make)
    yield swap, worker, old, give
    swap.close()
    worker.close()


def stepped(swap, state):
    def look():
        swap.step()
        return swap.status()["state"] == state

    eventually(look)


def answer(worker):
    worker.submit(Question())
    return eventually(worker.poll)[1]


def fail(worker, **question):
    failed = worker.stats.failed
    worker.submit(Question(**question))
    eventually(lambda: worker.stats.failed > failed and worker.idle)


def proved(swap, worker, name):
    """On probation, until it is kept."""
    stepped(swap, "on probation")
    for done in range(PROBATION):
        swap.step()
        assert swap.status()["progress"] == f"{done} of {PROBATION} answers"
        assert answer(worker) == name
    stepped(swap, "kept")


def test_the_old_one_answers_until_the_new_one_is_loaded(swapping):
    swap, worker, old, give = swapping
    swap.request("new")
    assert swap.status() == {
        "state": "loading", "model": "new", "previous": "old", "detail": "", "progress": "",
        "number": 1, "key": CARD_KEY,
    }  # fmt: skip
    with pytest.raises(SwapError, match="new is still loading"):
        swap.request("other")
    swap.step()
    assert answer(worker) == "old"
    new = give("new", Named("new"))
    stepped(swap, "on probation")
    assert "loaded and asked in" in swap.status()["detail"]
    with pytest.raises(SwapError, match="new is still on probation"):
        swap.request("other")
    assert old.closed == 0
    proved(swap, worker, "new")
    assert swap.status()["detail"].startswith(f"{PROBATION} answers; loaded and asked in")
    eventually(lambda: old.closed == 1)
    assert answer(worker) == worker.name == worker.counts()["model"] == "new"
    assert new.closed == 0
    with pytest.raises(SwapError, match="new runs already"):
        swap.request("new")


def test_probation_ends_with_the_mission_that_asks(swapping):
    swap, worker, old, give = swapping
    swap.request("new")
    swap.step(idle=True)
    assert swap.status()["state"] == "loading"
    give("new", Named("new"))
    stepped(swap, "on probation")
    answer(worker)
    swap.step(idle=True)
    assert swap.status()["state"] == "kept"
    assert swap.status()["detail"].startswith("1 answers, and no mission runs that needs more; ")
    eventually(lambda: old.closed == 1)


def test_a_busy_model_is_closed_after_its_answer(swapping):
    swap, worker, old, give = swapping
    old.go.clear()
    worker.submit(Question())
    old.asked.wait()
    swap.request("new")
    give("new", Named("new"))
    stepped(swap, "on probation")
    assert worker.uses(old)
    swap.close()
    assert old.closed == 0
    old.go.set()
    assert eventually(worker.poll)[1] == "old"
    eventually(lambda: old.closed == 1)
    assert answer(worker) == "new"


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (UserError("prompt: no unicorns"), "prompt: no unicorns; old runs again"),
        (RuntimeError("no\nluck"), "it fails: RuntimeError: no luck; old runs again"),
    ],
)
def test_a_failure_on_probation_restores_the_old_model(swapping, error, says):
    swap, worker, old, give = swapping
    swap.request("new")
    new = give("new", Named("new"))
    stepped(swap, "on probation")
    assert answer(worker) == "new"
    new.error = error
    fail(worker)
    stepped(swap, "rolled back")
    assert swap.status()["detail"] == says
    eventually(lambda: new.closed == 1)
    assert answer(worker) == "old"
    assert old.closed == 0


def test_a_failure_without_an_image_does_not_count(swapping):
    swap, worker, old, give = swapping
    old.error = RuntimeError("of the old one")
    swap.request("new")
    new = give("new", Named("new"))
    stepped(swap, "on probation")
    new.error = RuntimeError("no image")
    fail(worker, rgb=False)
    new.error = None
    proved(swap, worker, "new")


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (UserError("no such card"), "no such card; old goes on"),
        (RuntimeError("no\nluck"), "it fails: RuntimeError: no luck; old goes on"),
    ],
)
def test_a_model_that_cannot_load_changes_nothing(swapping, error, says):
    swap, worker, old, give = swapping
    swap.request("bad")
    give("bad", error)
    stepped(swap, "refused")
    assert swap.status()["detail"] == says
    assert answer(worker) == "old"
    assert old.closed == 0
    swap.request("new")
    assert swap.status()["number"] == 2
    give("new", Named("new"))
    proved(swap, worker, "new")
