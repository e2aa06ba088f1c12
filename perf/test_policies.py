"""Benchmark: scoring of candidates, and choice of a goal among them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_mapping import CAMERA, MAPPING, T_BASE_CAMERA, explored_map

from edge import config
from edge.geometry import SE2
from edge.loop.goals.candidates import CandidatePool
from edge.loop.goals.goal import GoalTracker
from edge.loop.warmup import warm_mapping, warm_values
from edge.mapping.results import Frontiers
from edge.mapping.view import MapView
from edge.perception.tracking.instances import InstanceTracker
from edge.policies import make_policy
from edge.policies.base import PolicyInput, ScorerOutputs, scores_of
from edge.types import Detections, Observation

POSE = SE2(0.02, 0.02, 0.3)
CANDIDATES, BOXES = 200, 8


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_mapping(MAPPING)
    warm_values(MAPPING)


def detections(stamp_ns: int) -> Detections:
    """Return boxes all over the image, some with scores below the detection threshold."""
    rng = np.random.default_rng(2)
    left = rng.uniform(0, CAMERA.width_px - 60, BOXES)
    top = rng.uniform(0, CAMERA.height_px - 60, BOXES)
    seen = Observation(0, stamp_ns, POSE.matrix(), camera=CAMERA, T_base_camera=T_BASE_CAMERA)
    return Detections(
        seen,
        np.stack([left, top, left + 60, top + 60], axis=1).astype(np.float32),
        np.sort(rng.uniform(0.05, 0.9, BOXES))[::-1].astype(np.float32),
        np.zeros(BOXES, np.int32),
        ("chair",),
    )


def around(n: int) -> Frontiers:
    """Return n frontiers on all sides, 1 to 8 m away."""
    rng = np.random.default_rng(1)
    radius_m, angle = rng.uniform(1.0, 8.0, n), rng.uniform(-math.pi, math.pi, n)
    xy_m = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=1)
    return Frontiers(
        n, xy_m.astype(np.float32), np.full(n, 10, np.int32), np.arange(n, dtype=np.int32)
    )


@pytest.mark.parametrize("kind", ["vlfm", "adaptive"])
def test_score_by_values_30(benchmark, kind):
    """Measure thirty frontiers. Half have high values, so the tour has its largest size."""
    benchmark.extra_info["budget"] = f"score_{kind}_30"
    m = explored_map(1000)
    while m.travel_cost.generation == 0:
        m.travel_cost.step(POSE)
    m.values.set_targets(("chair",))
    m.values.weight[:] = 1
    high = np.random.default_rng(3).random(m.values.value.shape) < 0.03
    m.values.value[:] = np.where(high, 40000, 4000)
    pool = CandidatePool(30, 0.01)
    pool.update(around(30), [], 1, 1)
    pool.measure(m)
    policy = make_policy({"vlfm": config.PolicyVlfm, "adaptive": config.PolicyAdaptive}[kind]())
    context = PolicyInput(
        detections(stamp_ns=1).observation, POSE, MapView(m), (0, 0, 0, 0), pool.read_only, None,
        ScorerOutputs(), ("chair",), "chair", 2,
    )  # fmt: skip
    score = benchmark.pedantic(policy.score, args=(context,), rounds=500, warmup_rounds=20)
    assert np.ptp(score[:30]) > 0
    assert (score[:30] > 1.0).any() == (kind == "adaptive")


def test_score_and_select_200(benchmark):
    """Measure scores and goal with a reset policy, which computes eq. 3 for all in view."""
    benchmark.extra_info["budget"] = "score_and_select_200"
    m = explored_map(1000)
    while m.travel_cost.generation == 0:
        m.travel_cost.step(POSE)
    pool = CandidatePool(CANDIDATES, 0.01)
    pool.update(around(CANDIDATES), [], 1, 1)
    settings = config.Config(perception=config.PerceptionConfig(detector=config.DetectorSim()))
    policy, seen = make_policy(settings.policy), detections(stamp_ns=1)
    goals = GoalTracker(
        settings, pool, InstanceTracker(settings.perception), lambda goal: None, lambda *_: None
    )
    context = PolicyInput(
        seen.observation,
        POSE,
        MapView(m),
        (0, 0, 0, 0),
        pool.read_only,
        seen,
        ScorerOutputs(),
        ("chair",),
        "chair",
        2,
    )

    def reset() -> None:
        policy.reset("mission")
        goals.chooser.abandon()

    def score_and_select():
        return goals.chooser.choose(context, m, scores_of(policy, context), 0)

    goal = benchmark.pedantic(score_and_select, setup=reset, rounds=500, warmup_rounds=20)
    assert context.candidates.n == CANDIDATES
    assert goal is not None
    assert np.ptp(scores_of(policy, context)) > 0
