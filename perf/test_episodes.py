"""Benchmark: cost of ten simulated seconds of an episode, in one process."""

from __future__ import annotations

from edge.config import parse
from edge.lab.eval.closed_loop import ClosedLoop

CONFIG = {"perception": {"detector": {"kind": "sim"}}, "mission": {"target": "unicorn"}}
SECONDS = 10.0


def test_ten_seconds_of_an_episode(benchmark):
    benchmark.extra_info["budget"] = "episode_10_s"
    loops = iter([ClosedLoop(parse(CONFIG), colour=False) for _ in range(8)])
    loop = benchmark.pedantic(lambda: next(loops).run(SECONDS), rounds=6, warmup_rounds=2)
    assert loop.seconds >= SECONDS
    times = SECONDS / benchmark.stats.stats.median
    benchmark.extra_info["times_real_time"] = round(times, 1)
