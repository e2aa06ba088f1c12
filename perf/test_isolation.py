"""Benchmark: detection in a process of its own, and in a thread of the service."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from edge import config
from edge.loop.warmup import warm_perception
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import ModelError
from edge.types import Observation

SHARED_VOCABULARY = (
    Path(__file__).resolve().parents[2] / "shared" / "models" / "clip_vitb32_vocab.npz"
)
BACKGROUND = ("window", "door", "picture frame", "cabinet", "curtain", "person")
WORLD = {"model": "yolo-world-s-256x320-int8-cpu", "background": BACKGROUND}
OURS = {"model": "mini-house-256x320-int8-cpu"}


@pytest.fixture(scope="module", params=[WORLD, OURS], ids=["yolo-world", "mini-house"])
def model(request):
    """Return the configuration of a model that is installed."""
    vocabulary = str(SHARED_VOCABULARY) if SHARED_VOCABULARY.exists() else None
    return config.DetectorOnnx(vocabulary=vocabulary, **request.param)


@pytest.fixture
def detector(model, isolation):
    warm_perception()
    rules = config.ModelProcessConfig(timeout_s=60.0)
    perception = config.PerceptionConfig(isolation=isolation, process=rules, detector=model)
    try:
        detector = make_detector(perception, ["chair"])
    except (ModelError, PromptError) as error:
        pytest.skip(str(error))
    yield detector
    detector.close()


@pytest.mark.benchmark(timer=time.perf_counter)
@pytest.mark.parametrize("isolation", ["thread", "process"])
def test_detect(benchmark, detector, isolation, model):
    """Measure one detection in an image of 320 x 256 pixels, on two threads."""
    benchmark.extra_info["budget"] = f"detect_in_{isolation}_{model.model.partition('-256')[0]}"
    rgb = np.random.default_rng(0).integers(0, 256, (256, 320, 3), np.uint8)
    observation = Observation(0, 0, np.eye(4), rgb=rgb)
    benchmark.pedantic(detector.detect, (observation,), rounds=200, warmup_rounds=10)
