"""The loop with a detector on a server: whatever that does costs detections, never ticks."""

from __future__ import annotations

import socket
import threading

import numpy as np
import pytest
from kserve_server import KServe, serving
from patience import PATIENCE_S, eventually
from simulated import simulated
from test_loops import blanks, running_of

from edge import config
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.runner import loop
from edge.loop.status import status_message
from edge.perception.detection import remote as module
from edge.perception.detection.remote import RemoteDetector
from edge.perception.runtime.card_types import InferenceServer
from edge.perception.runtime.cards import load_card
from edge.perception.worker import DetectorWorker

SMALL = "mini-house-256x320-int8-cpu"


def nothing(feed):
    n = feed["txt_feats"].shape[1]
    return {"boxes": np.zeros((1, 9, 4), np.float32), "scores": np.zeros((1, 9, n), np.float32)}


@pytest.fixture
def remote(monkeypatch):
    """Return a detector on a server that looks for a bed."""
    monkeypatch.setattr(module, "PAUSE_S", 0.01)
    monkeypatch.setattr(module, "MAX_PAUSE_S", 0.01)
    made = []

    def make(server: KServe) -> RemoteDetector:
        server_config = InferenceServer(url=server.url, model="m", time_limit_s=60)
        card = load_card(SMALL).model_copy(update={"server": server_config, "file": None})
        monkeypatch.setattr("edge.perception.detection.onnx.load_detector_card", lambda name: card)
        made.append(RemoteDetector(config.DetectorOnnx(model=SMALL, threads=1), card, ("bed",)))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_ticks_continue_while_the_detector_server_hangs_or_is_gone(remote):
    gate, holds, stop = threading.Event(), threading.Event(), threading.Event()

    def hold(handler):
        holds.set()
        assert gate.wait(PATIENCE_S)
        handler.tell_the_truth()

    closed = ClosedLoop(simulated({"loop": {"hz": 200.0}, "mission": {"target": "bed"}}))
    with serving(KServe(nothing, behave=hold)) as server:
        worker = DetectorWorker(remote(server))
        seen = blanks(closed, 60)
        run = running_of(closed, seen, worker=worker)
        # The server answers only once all is seen: a tick that waited for it would wait for ever.
        loop(run, stop, each=lambda: None if seen else stop.set())
        assert run.service.latency.report().tick.count == 60
        assert holds.wait(PATIENCE_S)
        gate.set()
        eventually(lambda: worker.idle and worker.stats.done)
        assert status_message(run.service.result())["detector"]["state"] == "ok"
        server.behave = lambda handler: handler.connection.shutdown(socket.SHUT_RDWR)
        again, stop = blanks(closed, 60), threading.Event()
        run.source.observations = again
        loop(run, stop, each=lambda: None if again else stop.set())
        assert run.service.latency.report().tick.count == 120
        eventually(lambda: worker.idle)
        said = status_message(run.service.result())["detector"]
        assert said["state"] == "degraded"
        assert ": no connection: " in said["detail"]
        worker.close()
