"""The simulated robot's clock."""

from __future__ import annotations

import threading

from simulated import simulated

from edge.sim import process


class Drive:
    """A body that only writes down what it was told."""

    def __init__(self, stop: threading.Event, steps: int) -> None:
        self.motion = type("Motion", (), {"pose": None})()
        self.told: list[tuple[float, float]] = []
        self._stop, self._steps = stop, steps

    def step(self, dt_s: float, v_mps: float, w_radps: float) -> None:
        self.told.append((v_mps, w_radps))
        if len(self.told) == self._steps:
            self._stop.set()


def test_in_lockstep_a_robot_that_nobody_answers_stands(monkeypatch):
    stop = threading.Event()
    answers = iter([(0.5, 0.1), None, (0.4, 0.0)])
    monkeypatch.setattr(process, "make_rigs", lambda *_: [])
    monkeypatch.setattr(process, "_ask", lambda *_: next(answers))
    drive = Drive(stop, 3)
    process.run_lockstep(simulated(), None, drive, None, stop)
    assert drive.told == [(0.5, 0.1), (0.0, 0.0), (0.4, 0.0)]
