"""A model that runs here chooses among frontiers: in the loop, paused, swapped, failing."""

from __future__ import annotations

import numpy as np
import pytest
from patience import PATIENCE_S, eventually
from simulated import simulated
from tiny_vlm import publish

from edge.bus.verbs import Request
from edge.errors import UserError
from edge.host import resources
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.model_requests import MODEL_VERBS, ModelRequests
from edge.loop.status import status_message
from edge.perception.runtime.cards import ModelError
from edge.perception.swap.base import SwapError


@pytest.fixture
def models_dir(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    return resources.models_dir()


def settings(card="words"):
    choice = {"kind": "onnx", "card": card, "threads": 1, "time_limit_s": PATIENCE_S}
    return simulated(
        {
            "sim": {"lockstep": True},
            "loop": {"lockstep": False},
            "mission": {"target": "surfboard"},
            "perception": {"choice": choice},
        }
    )


class Failing:
    """Fake model that fails with an error of one line (see tests/perception)."""

    name = "words"

    def prepare(self, question):
        raise ModelError("model words: no answer within 5 s")

    def close(self):
        """Nothing is open."""


def requests_to(loop):
    """Return a function that makes model requests."""
    handle = ModelRequests(loop.service.detector_swap, loop.scorers).handle

    def request(do, **fields):
        verb = MODEL_VERBS[do]
        fields = verb.read(fields)
        prepared = verb.prepare(fields) if verb.prepare else None
        return handle(Request(do, fields, prepared=prepared), 0)

    return request


def test_a_model_of_another_family_is_swapped_in(models_dir):
    publish(models_dir, "text", "words")
    publish(models_dir, "smolvlm", "eyes")
    loop = ClosedLoop(settings())
    request = requests_to(loop)
    choice = eventually(lambda: loop.step() or loop.scorers.answers.choice)
    assert choice.p.sum() + choice.elsewhere == pytest.approx(1.0, abs=1e-5)
    assert request("status")["state"] == "idle"
    begun = request("use", model="eyes")
    assert (begun["state"], begun["model"], begun["number"]) == ("loading", "eyes", 1)
    assert begun["key"] == "perception.choice.card"
    with pytest.raises(SwapError, match="eyes is still loading"):
        request("use", model="eyes")

    for _ in range(3):
        loop.step()

    def switched():
        # Only a part of the tick: otherwise the house is explored before the model is loaded.
        loop.scorers.collect_answers(loop.service.map.grid.values)
        return request("status")["state"] == "on probation"

    eventually(switched)

    def kept():
        loop.step()
        eventually(lambda: loop.scorers._choice.idle)
        return request("status")["state"] == "kept"

    eventually(kept)
    since_ns = loop.service.stamp_ns
    seen = eventually(
        lambda: (
            loop.step()
            or (loop.scorers.answers.choice.stamp_ns > since_ns and loop.scorers.answers.choice)
        )
    )
    status = status_message(loop.service.result())["scorers"]["choice"]
    assert (status["model"], status["failed"]) == ("eyes", 0)
    assert status["swap"]["state"] == "kept"
    assert not np.array_equal(seen.p, choice.p)
    assert loop.service.status.phase == "searching"

    assert request("pause")["paused"]
    eventually(lambda: loop.scorers._choice.idle)
    asked = loop.scorers.status()["choice"]["asked"]
    for _ in range(10):
        loop.step()
    assert loop.scorers.status()["choice"]["asked"] == asked
    assert not request("resume")["paused"]
    eventually(lambda: loop.step() or loop.scorers.status()["choice"]["asked"] > asked)
    with pytest.raises(ModelError, match="no such card"):
        request("use", model="none")
    loop.close()


def test_a_failing_model_is_counted_and_the_loop_continues(models_dir, caplog):
    publish(models_dir, "text", "words")
    loop = ClosedLoop(settings())
    loop.scorers._choice.exchange(Failing())
    eventually(lambda: loop.step() or loop.scorers.status()["choice"]["failed"])
    assert loop.scorers.status()["choice"]["last_error"] == "model words: no answer within 5 s"
    assert loop.service.status.phase == "searching"
    loop.close()
    assert len([r for r in caplog.records if "no answer within" in r.getMessage()]) == 1


def test_requests_without_a_matching_scorer_are_refused(models_dir):
    publish(models_dir, "text", "words")
    loop = ClosedLoop(simulated({"sim": {"lockstep": True}, "loop": {"lockstep": True}}))
    request = requests_to(loop)
    with pytest.raises(UserError, match="no scorers are configured"):
        request("pause")
    with pytest.raises(SwapError, match=r"set perception\.choice\.kind to onnx"):
        request("use", model="words")
    loop.close()
