"""Benchmark: cost of a scrape of `/metrics`; `latency_ring_tick` measures its part of a tick."""

from __future__ import annotations

from types import SimpleNamespace

from edge.config import parse
from edge.host.service_manager import SystemdNotifier
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.monitoring.metrics import Metrics
from edge.loop.monitoring.service_health import ServiceHealth
from edge.loop.runner import RunningService


def test_metrics_scrape(benchmark):
    benchmark.extra_info["budget"] = "metrics_scrape"
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}}
    closed = ClosedLoop(parse({**lockstep, "perception": {"detector": {"kind": "sim"}}}))
    for _ in range(10):
        closed.step()
    worker = closed.service.perception.worker
    source = SimpleNamespace(counters={})
    metrics = Metrics(ServiceHealth(SystemdNotifier({})))
    running = RunningService(
        config=closed.config, service=closed.service, worker=worker, source=source, servers={}
    )
    metrics.add_service(running, closed.sinks)
    page = benchmark(metrics.pages()["/metrics"])
    assert b"edge_map_known_square_meters" in page.body
