"""What the soak's sink tells of the loop."""

from __future__ import annotations

import json

import pytest
from live_patience import eventually
from results import observation, result
from simulated import simulated

from edge.bus.session import Ring, zenoh_session
from edge.host.ports import free_port
from edge.lab.eval.soak.beat import KEY, BeatSink
from edge.loop.latency import LatencyRing

MS = 1_000_000


@pytest.fixture
def told():
    """A sink on a clock of the test's, and what it has told."""
    config = simulated({"zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"}})
    now = [100.0]
    with zenoh_session(config.zenoh, "listen") as session:
        ring = Ring(session, config.zenoh.key(KEY), 8)
        sink = BeatSink(config, session, lambda: now[0])

        def beat(after_s: float, **fields) -> None:
            now[0] += after_s
            sink.tick(result(**fields))

        def heard() -> dict:
            (sample,) = eventually(ring.take)
            return json.loads(sample.payload.to_bytes())

        yield beat, heard
        sink.close()


def test_a_second_in_which_nothing_was_seen_has_beats_and_no_tick(told):
    beat, heard = told
    for _ in range(4):
        beat(0.25)
    said = heard()
    assert (said["seconds"], said["ticks"], said["beats"]) == (1.0, 0, 4)
    assert said["interval_ms"] is None
    assert said["gap_ms"] == [250.0, 250.0, 250.0]
    assert said["tick_ms"] == [0.0, 0.0, 0.0]


def test_each_second_is_told_by_itself(told):
    beat, heard = told
    ring = LatencyRing()
    for duration_ms in (2, 4):
        ring.begin_tick(0)
        ring.end_tick(duration_ms * MS)
    for after_s in (0.1, 0.9):
        beat(after_s, observation=observation(1), latency=ring.report)
    said = heard()
    assert (said["ticks"], said["beats"]) == (2, 2)
    assert said["interval_ms"] == said["gap_ms"] == [500.0, 892.0, 900.0]
    assert said["tick_ms"] == [3.0, 3.98, 4.0]
    beat(0.5)
    beat(0.5, observation=observation(2))
    said = heard()
    assert (said["ticks"], said["beats"]) == (1, 2)
    assert said["interval_ms"] == [1000.0, 1000.0, 1000.0]
