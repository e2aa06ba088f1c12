"""The tick rate, from the latency messages of the service."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from simulated import simulated

from edge.lab.eval.soak import monitor


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """Return a monitor, and a function that lets a latency message come at a time."""
    session = SimpleNamespace(declare_subscriber=lambda key, handle: None)
    harness = SimpleNamespace(config=simulated(), out=tmp_path, session=session)
    clock = SimpleNamespace(monotonic=lambda: clock.now_s, now_s=0.0)
    monkeypatch.setattr(monitor, "time", clock)
    watched = monitor.SoakMonitor(harness)

    def come(now_s: float, count: int) -> None:
        clock.now_s = now_s
        watched._on_latency({"tick": {"count": count}})

    return watched, come


def test_the_tick_rate_is_that_of_the_newest_messages(watched):
    monitor, come = watched
    assert (monitor.beat_s, monitor.ticks_hz(0.0), monitor.usual_hz) == (0.0, 0.0, 0.0)
    for now_s, count in ((1.0, 0), (2.0, 10), (3.0, 20), (5.0, 60)):
        come(now_s, count)
    assert monitor.beat_s == 5.0
    assert monitor.ticks_hz(2.0) == pytest.approx(50 / 3)
    assert monitor.usual_hz == pytest.approx(10.0)
    assert monitor.ticks_hz(2.1) == 0.0  # a fault ended since


def test_a_count_that_begins_again_has_no_rate(watched):
    monitor, come = watched
    for now_s, count in ((1.0, 100), (2.0, 110), (3.0, 5)):
        come(now_s, count)
    assert monitor.ticks_hz(0.0) == 0.0
    assert monitor.usual_hz == pytest.approx(10.0)


def test_the_rate_under_faults_is_not_the_usual_one(watched):
    monitor, come = watched
    monitor.calm = False
    for now_s in (1.0, 2.0, 3.0):
        come(now_s, int(now_s))
    assert monitor.ticks_hz(0.0) == pytest.approx(1.0)
    assert monitor.usual_hz == 0.0
