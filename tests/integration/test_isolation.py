"""The service while its model's process is killed, stopped and brought back."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from live_patience import PATIENCE_S, eventually

sys.path.insert(0, str(Path(__file__).parents[1] / "perception"))
from fake_model_process import __file__ as fake

from edge.config import parse
from edge.errors import Stopped
from edge.geometry import CameraModel
from edge.launch import LaunchedService, open_service
from edge.loop.runner import loop
from edge.loop.status import status_message
from edge.perception.process import link, supervised
from edge.types import Observation

TICKS = 10  # with an image each, that the loop makes while there is no model
RATE_HZ = 30.0


class Camera:
    """A source of images of greys with a wall, as many as are asked for."""

    epoch, pose, inbox = 0, None, SimpleNamespace(poll=list, overruns=0)

    def __init__(self) -> None:
        self.counters = Counter(received=0, observations=0)

    def poll(self) -> Observation:
        self.counters["observations"] += 1
        n = self.counters["observations"]
        rgb = np.broadcast_to(np.arange(96, 160, dtype=np.uint8)[:, None, None], (64, 64, 3))
        depth = np.full((64, 64), 2.0, np.float32)
        camera = CameraModel.from_hfov(64, 64, 1.3)
        stamp_ns = int(n * 1e9 / RATE_HZ)
        return Observation(n, stamp_ns, np.eye(4), rgb=rgb, depth_m=depth, camera=camera)

    def close(self) -> None: ...


class Life:
    """The loop under way, one step of a story at a time."""

    def __init__(self, running: LaunchedService) -> None:
        self.running, self.stop = running, threading.Event()
        self.detector = running.worker.detector

    def until(self, what: Callable[[], object], ticks: int = 0) -> int:
        """Have the loop go on until something is true, and then for so many ticks; all ticks."""
        made, left, deadline_s = 0, ticks, time.monotonic() + PATIENCE_S

        def each() -> None:
            nonlocal made, left
            made += 1
            if what() and (left := left - 1) < 0:
                self.stop.set()
            assert time.monotonic() < deadline_s, "it did not happen"

        self.stop.clear()
        loop(self.running, self.stop, each=each)
        return made

    def until_it_sees(self) -> int:
        """Until an image that is yet to come was looked at, or none will be; the ticks."""
        stats, done = self.running.worker.stats, self.running.worker.stats.done + 1
        return self.until(lambda: stats.done > done or self.state() == "degraded")

    def images(self) -> int:
        """Return the number of images that the loop has taken."""
        return self.running.source.counters["observations"]

    def status(self) -> dict:
        return status_message(self.running.service.result())["detector"]

    def state(self) -> str:
        return self.detector.health().state

    def model(self) -> psutil.Process:
        """Return the model's process."""
        (mine,) = fakes()
        return mine


def fakes() -> list[psutil.Process]:
    """Return the live model processes; one that has just ended may be listed still."""
    found = []
    for child in psutil.Process().children():
        with suppress(psutil.NoSuchProcess):  # so is a zombie to psutil
            found += [child] if fake in child.cmdline() else []
    return found


@pytest.fixture
def live(endpoint, tmp_path, monkeypatch) -> Callable:
    """live(stop, says, **process): a service whose model's process is a fake.

    `says` is what `script` holds at first, which tells the fake what to do.
    """
    monkeypatch.setattr(link, "PROGRAM", (sys.executable, fake))
    script = tmp_path / "script"

    @contextmanager
    def start(
        stop: threading.Event | None = None, says: str = "", **process: object
    ) -> Iterator[tuple[Life, Path]]:
        script.write_text(says)
        perception = {
            "isolation": "process",
            "process": process,
            "confirm_hits": 10**6,  # the mission outlasts the test
            "detector": {"kind": "onnx", "model": "steered", "vocabulary": str(script)},
        }
        config = parse({
            "zenoh": {"endpoint": endpoint}, "perception": perception,
            "loop": {"hz": RATE_HZ}, "mission": {"target": "chair", "time_limit_s": 1e6},
        })  # fmt: skip
        with open_service(config, [], stop=stop) as running:
            zenoh, running.source = running.source, Camera()
            yield Life(running), script
            running.source = zenoh
        eventually(lambda: not fakes(), "a process is left")

    return start


PATIENT = {"timeout_s": PATIENCE_S, "start_timeout_s": PATIENCE_S}


def test_loop_and_map_continue_while_the_model_hangs_or_ends(live, monkeypatch):
    for name, value in {"BACKOFF_S": 0.01, "MOST_ENDS": 1, "WINDOW_S": 1e6}.items():
        monkeypatch.setattr(supervised, name, value)
    with live(**PATIENT) as (life, script):
        life.until_it_sees()
        process = life.model()
        process.suspend()
        before = life.images()
        life.until(lambda: True, TICKS)
        assert life.images() - before >= TICKS
        process.resume()
        for state in ("restarting", "degraded"):
            life.until_it_sees()
            assert life.model().pid == process.pid or state == "degraded"
            script.write_text("wait")
            before = life.images()
            life.model().kill()
            life.until(lambda state=state: life.state() == state, TICKS)
            assert life.images() - before >= TICKS
            assert life.status()["state"] == state
            script.write_text("")
        assert "ended too often, restarts in" in life.status()["detail"]
        assert life.status()["failures"].keys() == {"ModelProcessError"}
        assert not life.running.service.status.done


def test_a_stop_is_obeyed_while_the_model_loads(live, caplog):
    caplog.set_level(logging.INFO, "edge")
    stop = threading.Event()

    def stop_when_it_loads() -> None:
        eventually(fakes)
        stop.set()

    stopper = threading.Thread(target=stop_when_it_loads)
    stopper.start()
    with pytest.raises(Stopped), live(stop, "wait", start_timeout_s=1e6):
        raise AssertionError
    stopper.join()
    eventually(lambda: not fakes(), "a process is left")
    assert [r.getMessage() for r in caplog.records if r.name == "edge"] == [
        "stopped during the start, before the service was ready"
    ]
