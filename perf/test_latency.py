"""Benchmark: cost of timing a tick, and of a latency report."""

from __future__ import annotations

import time

from edge.loop.latency import LatencyRing
from edge.loop.stages import STAGES

IN_TICK = tuple(i for i, stage in enumerate(STAGES) if stage.in_tick)


def _tick(ring: LatencyRing) -> None:
    clock = time.perf_counter_ns
    ring.begin_tick(clock())
    for stage in IN_TICK:
        ring.mark(stage, clock())
    ring.end_tick(clock())


def test_latency_ring_tick(benchmark):
    benchmark.extra_info["budget"] = "latency_ring_tick"
    ring = LatencyRing()
    benchmark(_tick, ring)
    assert ring.report().stage("publish").n > 0


def test_latency_report_300(benchmark):
    benchmark.extra_info["budget"] = "latency_report_300"
    ring = LatencyRing()
    for _ in range(400):
        _tick(ring)
    assert benchmark(ring.report, 300).tick.n == 300
