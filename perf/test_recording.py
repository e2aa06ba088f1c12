"""Benchmark: cost of recording a tick, in the loop's thread and in the writer."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np
import pytest

from edge.config import parse
from edge.lab.eval.closed_loop import ClosedLoop
from edge.sinks.encoder import ResultEncoder
from edge.sinks.mcap import McapSink

TICKS = 32


class ResultStore:
    """Sink that keeps results, with copies of the images that the simulator overwrites."""

    def __init__(self) -> None:
        self.results = []

    def tick(self, result) -> None:
        observation = result.observation
        if observation is not None:
            observation = replace(
                observation, rgb=observation.rgb.copy(), depth_m=observation.depth_m.copy()
            )
        self.results.append(replace(result, observation=observation))

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def results():
    """Return the results of one second of the demo, with depth rounded to millimetres."""
    lockstep = {"lockstep": True}
    perception = {"detector": {"kind": "sim"}}
    store = ResultStore()
    closed = ClosedLoop(
        parse({"loop": lockstep, "sim": {**lockstep, "step_s": 1 / 30}, "perception": perception}),
        sinks=[store],
    )
    look = closed.rig.look

    def look_in_millimetres(pose) -> None:
        look(pose)
        depth_m = closed.rig.depth_m
        mm = np.nan_to_num(depth_m * 1000.0).clip(0, 65535).astype(np.uint16)
        np.multiply(mm, np.float32(0.001), out=depth_m)

    closed.rig.look = look_in_millimetres
    for _ in range(TICKS):
        closed.step()
    yield closed.config, store.results
    closed.close()


def test_record_a_tick_in_the_loop(benchmark, results):
    """Measure the loop thread's part: depth in millimetres, and an image twice a second."""
    config, ticks = results
    encoder = ResultEncoder(config, rgb_hz=2.0)

    def one_pass():
        for result in ticks:
            encoder.capture(result)

    benchmark.extra_info["budget"] = "record_take_32"
    benchmark(one_pass)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_record_a_tick(benchmark, against, results, tmp_path, compression):
    """Compare the entire recording, in one thread, with zlib on the depth of one second."""
    config, ticks = results
    sink = McapSink(config, str(tmp_path), compression=compression)

    def write():
        for result in ticks:
            sink.tick(result)

    depth = (ticks[0].observation.depth_m * 1000.0).astype(np.uint16).tobytes()
    benchmark.extra_info["budget"] = f"record_32_{compression}"
    against(lambda: [zlib.compress(depth, 1) for _ in range(TICKS)])
    benchmark(write)
    assert sink.status()["failed"] == 0
    sink.close()
