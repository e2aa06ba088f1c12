"""The loops around the service, with a source and a controller played by the test."""

from __future__ import annotations

import threading
import time
from collections import Counter
from itertools import pairwise
from types import SimpleNamespace

import pytest
from closed_loop import ClosedLoop, blank_observation
from simulated import simulated

from edge import runner
from edge.geometry import SE2
from edge.runner import Running, loop
from edge.stages import STAGES
from edge.types import Observation


class Source:
    """Gives out what it was given; a new epoch begins with an observation of `jump_at`."""

    def __init__(self, observations: list[Observation], jump_at: int = -1) -> None:
        self.counters = Counter(received=0, observations=0)
        self.epoch = 0
        self.pose: SE2 | None = None
        self._observations = observations
        self._jump_at = jump_at

    def wait(self, timeout_s: float) -> bool:
        if not self._observations:
            time.sleep(0.001)
        return bool(self._observations)

    def poll(self) -> Observation | None:
        if not self._observations:
            return None
        observation = self._observations.pop(0)
        self.epoch += observation.seq == self._jump_at
        return observation

    def close(self) -> None: ...


def running(lockstep: bool, frames: int = 0, jump_at: int = -1, **mission) -> Running:
    config = simulated(
        {"loop": {"lockstep": lockstep, "hz": 200.0}, "mission": {"target": "bed", **mission}}
    )
    closed = ClosedLoop(config)
    seen = [blank_observation(i, 10**9 + i * 10**8, SE2(0, 0, 0), closed) for i in range(frames)]
    inbox, desk = SimpleNamespace(poll=list), SimpleNamespace(poll=lambda: None)
    service, source = closed.service, Source(seen, jump_at)
    return Running(config, None, service, service._worker, source, inbox, desk, desk)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("frames", [0, 2])
def test_once_ends_though_nothing_is_to_be_seen_any_more(lockstep, frames):
    # The first tick loads kernels; simulated time stands still meanwhile.
    run = running(lockstep, frames, time_limit_s=0.5)
    status = loop(run, threading.Event(), once=True)
    assert status.phase == "failed"
    assert "0.5 s" in status.reason


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_new_epoch_begins_before_its_first_frame_is_taken_in(lockstep, monkeypatch):
    run, done, stop = running(lockstep, frames=4, jump_at=2), [], threading.Event()
    monkeypatch.setattr(run.service, "forget_places", lambda now_ns: done.append("forget"))
    monkeypatch.setattr(run.service, "tick", lambda o, now_ns: done.append(o.seq))
    loop(run, stop, each=lambda: stop.set() if 3 in done else None)
    assert done == [0, 1, "forget", 2, 3]


def test_a_wall_clock_that_is_set_does_not_end_a_mission(monkeypatch):
    run, stop, ticks = running(False, time_limit_s=300.0), threading.Event(), []
    monkeypatch.setattr(runner.time, "time_ns", lambda: 10**18 + len(ticks) * 10**13)

    def each() -> None:
        ticks.append(run.service.status)
        if len(ticks) == 5:
            stop.set()

    assert loop(run, stop, once=True, each=each).phase == "searching"
    assert len(ticks) == 5


@pytest.mark.parametrize("steps_s", [(1.0, -400.0, 1.0), (1.0, 1e9, 1.0), (1.0, -3e9, 2.5e9)])
def test_a_sensor_clock_that_is_set_anew_neither_turns_lockstep_back_nor_ahead(steps_s):
    """Else what waits until a time waits for ever, or a mission is over by its limit."""
    run, stop, times = running(True, time_limit_s=300.0), threading.Event(), []
    run.service.tick = lambda observation, now_ns: times.append(now_ns)
    stamp_ns = 2 * 10**9
    seen = [SimpleNamespace(seq=0, stamp_ns=stamp_ns, release=lambda: None)]
    for step_s in steps_s:
        stamp_ns += int(step_s * 1e9)
        seen.append(SimpleNamespace(seq=0, stamp_ns=stamp_ns, release=lambda: None))
    run.source._observations = seen
    loop(run, stop, each=lambda: stop.set() if len(times) == 4 else None)
    assert times[:2] == [2 * 10**9, 3 * 10**9]
    assert [b - a for a, b in pairwise(times)] == [10**9 * (0 < s <= 60) for s in steps_s]


def test_the_service_takes_the_stages_in_the_order_of_the_table():
    from edge import service

    for index, stage in enumerate(STAGES):
        assert getattr(service, stage.name.upper()) == index
