"""The simulated robot's clock."""

from __future__ import annotations

import threading

import pytest
from simulated import simulated

from edge.bus import topics
from edge.geometry import SE2
from edge.lab.sim import process
from edge.lab.sim.robot import MotionState


class Drive:
    """A body that only records its commands."""

    def __init__(self, stop: threading.Event, steps: int) -> None:
        here = SE2(0.0, 0.0, 0.0)
        self.motion = MotionState(0, here, here, 0.0, 0.0, 0, False, 0.0)
        self.received: list[tuple[float, float]] = []
        self._stop, self._steps = stop, steps

    def step(self, dt_s: float, v_mps: float, w_radps: float) -> None:
        self.received.append((v_mps, w_radps))
        if len(self.received) == self._steps:
            self._stop.set()


class Bus:
    """Answers an instant when it was sent for the `late`th time, and another one before."""

    def __init__(self, late: int) -> None:
        self._late, self.sent = late, 0

    def send(self, batch) -> None:
        self.sent += any(topic is topics.ODOMETRY for topic, _ in batch)

    def take_commands(self):
        return [(0, 0.5, 0.1)] if self.sent >= self._late else [(7, 9.0, 9.0)]


@pytest.mark.parametrize("late", [1, 3])
def test_lockstep_holds_the_clock_until_an_answer_comes(monkeypatch, caplog, late):
    stop = threading.Event()
    for limit in ("REPEAT_S", "WARN_AFTER_S", "_POLL_S"):
        monkeypatch.setattr(process, limit, 0.0)
    monkeypatch.setattr(process, "make_rigs", lambda *_: [])
    drive, bus = Drive(stop, 1), Bus(late)
    process.run_lockstep(simulated(), None, drive, bus, stop)
    assert drive.received == [(0.5, 0.1)]
    assert bus.sent == late
    assert ("check that the controller runs" in caplog.text) == (late > 1)
