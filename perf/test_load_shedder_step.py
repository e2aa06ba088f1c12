"""Benchmark: cost of the load shedder in each tick."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / "tests" / folder) for folder in ("", "loop")]
from test_load_shedder import Bench

from edge.loop import load_shedder


def test_load_shedder_step(benchmark, monkeypatch):
    """Measure a step after a new image; each tenth step evaluates the last second."""
    benchmark.extra_info["budget"] = "load_shedder_step"
    monkeypatch.setattr(load_shedder, "_check_model_is_here", lambda name: None)
    bench = Bench()

    def see() -> tuple[tuple, dict]:
        bench.see()
        return (bench.now_ns,), {}

    benchmark.pedantic(bench.shedder.step, setup=see, rounds=600, warmup_rounds=60)
    assert bench.shedder.status()["state"] == "steady"
    assert bench.reads > 0
    bench.close()
