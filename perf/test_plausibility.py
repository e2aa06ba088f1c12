"""Benchmark: cost of the plausibility checks, against reading the depth image once."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from edge.config import parse
from edge.geometry import SE2, CameraModel
from edge.loop.checks.plausibility import Plausibility
from edge.types import Observation

CAMERA = CameraModel.from_hfov(640, 480, math.radians(75))
CONFIG = parse({"perception": {"detector": {"kind": "sim"}}})
T_BASE_CAMERA = CONFIG.sensors.camera.T_base_camera()
TICK_NS = 33_333_333


def view(k: int, step_m: float) -> Observation:
    """Return a view of a floor and a far wall, from a robot that drives towards the wall."""
    rng = np.random.default_rng(k)
    row = (np.arange(480) - CAMERA.cy_px) / CAMERA.fy_px
    down = np.maximum(-(T_BASE_CAMERA[2, 1] * row + T_BASE_CAMERA[2, 2]), 1e-3)
    depth_m = np.minimum(T_BASE_CAMERA[2, 3] / down, 6.0 - step_m * k)[:, None]
    depth_m = (depth_m + rng.normal(0.0, 0.002, (480, 640))).astype(np.float32)
    rgb = rng.integers(0, 255, (480, 640, 3), np.uint8)
    pose = SE2(step_m * k, 0.0, 0.0).matrix()
    return Observation(k, k * TICK_NS, pose, rgb, depth_m, CAMERA, T_BASE_CAMERA)


@pytest.mark.parametrize(
    ("budget", "step_m"), [("plausibility_standing", 0.0), ("plausibility_driving", 0.017)]
)
def test_judging_an_observation(benchmark, against, budget, step_m):
    benchmark.extra_info["budget"] = budget
    frames = [view(k, step_m) for k in range(30)]
    against(lambda: np.multiply(frames[0].depth_m, np.float32(0.001)))
    stage = Plausibility(CONFIG, lambda *_: None)
    there_and_back = itertools.cycle((*frames, *frames[-2:0:-1]))
    now_ns = itertools.count(0, TICK_NS)
    benchmark.pedantic(
        lambda: stage.permitted_use(next(there_and_back), next(now_ns)),
        rounds=500,
        warmup_rounds=20,
    )
    assert stage.failed == ()
