"""Kinds of ground in a running service: named by a network in the background, for tasks."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from simulated import simulated
from tiny_ground import put_network

from edge.lab.eval.closed_loop import ClosedLoop, wants_colour
from edge.loop.behaviours import plan_worker
from edge.loop.status import status_message

pytest.importorskip("onnxruntime")

ONTO = "go onto the {}"


@pytest.fixture(autouse=True)
def model_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))


def settings(tasks: dict | None = None, lockstep: bool = True):
    camera = {"width_px": 160, "height_px": 128}
    return simulated(
        {
            "loop": {"lockstep": lockstep},
            "sim": {"lockstep": True, "step_s": 0.2},
            "sensors": {"camera": camera},
            "tasks": tasks or {},
        }
    )


class Classifier:
    """Names each pixel as a function of the picture's columns."""

    kinds = ("road", "lawn")

    def __init__(self, kind_of=lambda columns: np.ones_like(columns)):
        self.kind_of, self.threads, self.go = kind_of, set(), threading.Event()

    def classify(self, rgb):
        self.threads.add(threading.current_thread())
        self.go.wait(60.0)
        h, w = rgb.shape[:2]
        return np.broadcast_to(self.kind_of(np.arange(w) / w), (h, w)).astype(np.uint8)

    def status(self):
        return {}


def driving(task: str, classifier: Classifier | None, lockstep: bool = True) -> ClosedLoop:
    loop = ClosedLoop(settings(lockstep=lockstep), task=task)
    loop.service.reconfigure(loop.config, loop.service.perception.policy, classifier)
    return loop


def lawn_to_the_right(columns):
    return 1 + (columns > 0.6)


@pytest.mark.parametrize(
    ("task", "named", "phase", "says"),
    [
        (ONTO.format("grass"), lawn_to_the_right, "reached", "onto lawn"),
        (ONTO.format("road"), lawn_to_the_right, "reached", "onto road"),
        # No network: there is nothing to wait for. A kind that it never names: neither.
        (ONTO.format("grass"), None, "failed", "there is floor"),
        (ONTO.format("plaza"), lawn_to_the_right, "failed", "there is lawn, road"),
    ],
)
def test_a_task_reads_the_ground_that_the_pictures_show(task, named, phase, says):
    classifier = None if named is None else Classifier(named)
    if classifier is not None:
        classifier.go.set()
    loop = driving(task, classifier).run(60)
    status = loop.service.status
    assert status.phase == phase, loop.notes.events
    assert says in " ".join([status.reason, *loop.notes.events])
    loop.close()


def test_ground_that_is_not_in_view_is_looked_for():
    classifier = Classifier(np.zeros_like)  # no ground at all
    classifier.go.set()
    loop = driving(ONTO.format("grass"), classifier).run(4)
    assert loop.service.behaviour.searching
    assert any("there is floor: exploring further" in text for text in loop.notes.events)
    classifier.kind_of = lawn_to_the_right
    loop.run(60)
    assert loop.service.status.phase == "reached", loop.notes.events
    loop.close()


def test_the_loop_does_not_wait_for_the_network():
    classifier = Classifier()
    loop = driving("go straight for 1 metre", classifier, lockstep=False)
    for _ in range(5):
        loop.step()
    assert loop.service.behaviour.task_status().phase == "writing"
    assert threading.current_thread() not in classifier.threads
    classifier.go.set()
    loop.close()


def test_the_network_gets_one_image_per_period(monkeypatch):
    monkeypatch.setattr(plan_worker, "GROUND_PERIOD_NS", 2_000_000_000)
    config = settings({"ground": put_network().model_dump()})
    assert wants_colour(config)
    loop = ClosedLoop(config, task="go straight for 300 metres")
    assert status_message(loop.service.result())["ground"]["made"] == 0
    while loop.seconds < 5.9:
        loop.step()
    status = status_message(loop.service.result())["ground"]
    assert status == {"model": "tiny-ground", "made": 3, "failed": 0, "last_error": ""}
    loop.close()


def test_a_network_that_fails_is_reported_and_ends_no_task():
    loop = ClosedLoop(settings({"ground": put_network().model_dump()}), task=ONTO.format("road"))
    loop.service.ground._session = None
    loop.run(3)
    status = status_message(loop.service.result())["ground"]
    assert (status["made"], status["failed"] > 0) == (0, True)
    assert "NoneType" in status["last_error"]
    assert not loop.service.status.done
    loop.close()
