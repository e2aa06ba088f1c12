"""Health of the service for its watchers while the loop runs, fails or hangs."""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated
from test_loops import blanks, running_of

from edge.host.service_manager import SystemdNotifier
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.error_boundary import DEGRADED_AFTER
from edge.loop.monitoring.service_health import HANGS_S, ServiceHealth
from edge.loop.runner import RunningService
from edge.perception.runtime.health import ModelHealth
from edge.perception.worker import DetectorWorker
from edge.sources.synchronizer import TimeSynchronizer

MODULE = ServiceHealth.__module__
WATCHDOG_S = 8.0


class Watched:
    """Vitals with a clock of the test's, and the manager's end of a real socket."""

    def __init__(self, listening: socket.socket, name: str) -> None:
        self.now_s = 100.0
        environ = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))}
        self.vitals = ServiceHealth(SystemdNotifier(environ), lambda: self.now_s)
        self._listening = listening
        config = simulated({"mission": {"target": "bed"}, "loop": {"blind_s": 1.0}})
        self.closed = ClosedLoop(config, colour=False)
        self.running: RunningService = running_of(self.closed, [])

    def beat(self, after_s: float = 0.0) -> list[str]:
        """Return the service manager's messages of one heartbeat."""
        self.now_s += after_s
        self.vitals.beat(self.running)
        return self.notified()

    def notified(self) -> list[str]:
        said = []
        while True:
            try:
                said += self._listening.recv(65536).decode().split("\n")
            except BlockingIOError:
                return said

    def see(self) -> None:
        (seen,) = blanks(self.closed, 1)
        self.running.service.tick(seen, seen.stamp_ns)

    def page(self, path: str) -> tuple[int, dict]:
        page = self.vitals.pages()[path]()
        return int(page.status), json.loads(page.body)


@pytest.fixture
def watched(tmp_path) -> Iterator[Watched]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        yield Watched(listening, str(tmp_path / "notify"))


def test_the_service_is_ready_after_its_first_observation(watched):
    watched.vitals.ready()
    assert watched.notified() == ["READY=1"]
    assert watched.page("/readyz")[1]["why"] == ["no usable observations"]
    assert watched.beat()[-1] == "STATUS=not ready: no usable observations (searching: bed)"
    watched.see()
    assert watched.beat(1.0)[-1] == "STATUS=searching: bed"
    assert watched.page("/readyz") == (200, {"ok": True, "state": "running", "why": []})
    watched.beat(2.0)
    assert watched.vitals.no_observation_s == 2.0
    assert watched.page("/readyz")[0] == 503, "the camera is gone"


def test_a_missing_input_is_named_and_logged_once(watched, caplog):
    inputs = TimeSynchronizer(watched.closed.config, lambda: 0).inputs
    watched.running.service.parts_status.inputs = inputs.rows
    watched.vitals.ready()
    why = "no usable observations: no message yet on camera/rgb, camera/depth, camera/info, odom"
    assert watched.beat()[-1] == f"STATUS=not ready: {why} (searching: bed)"
    assert watched.page("/readyz")[1]["why"] == [why]
    assert caplog.messages == [], "sensors may start a moment later"
    for _ in range(20):
        watched.beat(1.0)
    assert caplog.messages == [why]
    for name in ("odom", "camera/info"):
        inputs.on_message(name)
    for _ in range(20):
        watched.beat(1.0)
    assert caplog.messages[1:] == [why.replace(", camera/info, odom", "")]
    watched.see()
    watched.beat(1.0)
    assert watched.page("/readyz")[0] == 200


def test_implausible_data_make_the_service_not_ready(watched):
    watched.vitals.ready()
    watched.see()
    watched.beat(1.0)
    assert watched.page("/readyz")[0] == 200
    service = watched.running.service
    service.plausibility = SimpleNamespace(
        why={"degrade": "floor: not there", "stand": ""}.get, blind_s=1.0
    )
    watched.beat(1.0)
    assert watched.page("/readyz")[1]["why"] == ["floor: not there"]


def test_only_loop_beats_send_watchdog_pings(watched):
    watched.vitals.ready()
    watched.notified()
    pings = [watched.beat(0.5).count("WATCHDOG=1") for _ in range(16)]
    assert sum(pings) == 4
    watched.now_s += HANGS_S - 0.1
    assert watched.page("/healthz")[0] == 200
    watched.now_s += 0.2
    assert watched.vitals.silent_s == pytest.approx(HANGS_S + 0.1)
    for path in ("/healthz", "/readyz"):
        status, said = watched.page(path)
        assert (status, said["why"]) == (503, ["the loop has hung for 10 s"])
    assert watched.notified() == []
    watched.beat()
    assert watched.page("/healthz")[0] == 200


def test_repeated_failures_make_the_service_not_ready(watched):
    watched.see()
    watched.vitals.ready()
    assert watched.beat()[-1].startswith("STATUS=searching")
    for _ in range(DEGRADED_AFTER):
        watched.running.service.error_boundary.on_error("tick", ValueError("bad"), 0)
    watched.running.worker.stats.in_a_row = DEGRADED_AFTER
    said = watched.beat(1.0)[-1]
    assert said.startswith("STATUS=not ready: the loop is degraded: tick: ValueError")
    assert "the detector is degraded" in said
    assert watched.page("/readyz")[0] == 503
    assert watched.page("/healthz")[0] == 200, "it goes on, and what fails may come back"


class Stuck:
    """A detector that never comes back from its first image, until the test is over."""

    name, prompts, invalid_boxes = "stuck", ("bed",), 0

    def __init__(self) -> None:
        self.over = threading.Event()

    def detect(self, observation):
        self.over.wait()
        raise ValueError("let go")

    def health(self) -> ModelHealth:
        return ModelHealth()

    def close(self) -> None: ...


def test_a_detector_that_hangs_at_an_image_is_noticed(watched):
    detector = Stuck()
    worker = DetectorWorker(detector)
    watched.running = running_of(watched.closed, [], worker=worker)
    watched.vitals.ready()
    (seen,) = blanks(watched.closed, 1)
    watched.beat()
    worker.submit(replace(seen, rgb=np.zeros((2, 2, 3), np.uint8)))
    for _ in range(int(HANGS_S)):
        watched.beat(1.0)
    assert watched.vitals.problems() == ("no usable observations",)
    watched.beat(1.0)
    assert "the detector has hung at one image for more than 10 s" in watched.vitals.problems()
    detector.over.set()
    worker.close()
    watched.beat(1.0)
    assert watched.vitals.problems() == ("no usable observations",)


def test_too_many_open_files_make_the_service_not_ready(watched, monkeypatch, caplog):
    short = "no file or connection can be opened (Too many open files; see `ulimit -n`)"
    watched.vitals.ready()
    for why, logged in ((short, short), (short, ""), ("", "can be opened again"), ("", "")):
        caplog.clear()
        monkeypatch.setattr(f"{MODULE}.open_files_problem", lambda why=why: why)
        with caplog.at_level(logging.INFO, MODULE):
            watched.beat(after_s=1.0)
        said = [r.message for r in caplog.records if r.name == MODULE]
        assert len(said) == bool(logged)
        assert logged in "".join(said)
        _, page = watched.page("/readyz")
        assert (short in page["why"]) is bool(why)
