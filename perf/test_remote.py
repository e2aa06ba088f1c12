"""Benchmark: cost of a detector on a server for the client, without the server's computation."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from edge import config
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.detection.remote import RemoteDetector
from edge.perception.runtime.card_types import DetectCard, InferenceServer
from edge.perception.runtime.cards import load_card_of
from edge.types import Observation

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from kserve_server import KServe, serving

CARD = "mini-house-256x320-int8-cpu"
ANCHORS = 1680


def nothing(feed: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the outputs of a detector that finds nothing."""
    n = feed["txt_feats"].shape[1]
    boxes, scores = (np.zeros((1, ANCHORS, width), np.float32) for width in (4, n))
    return {"boxes": boxes, "scores": scores}


def test_detect_on_a_server(benchmark, against, monkeypatch):
    """Compare the client's processor time with a run of the same network on one thread here."""
    benchmark.extra_info["budget"] = "detect_on_a_server"
    rgb = np.random.default_rng(0).integers(0, 256, (256, 320, 3), np.uint8)
    observation = Observation(0, 1, np.eye(4), rgb=rgb)
    settings = config.DetectorOnnx(model=CARD, threads=1)
    local = OnnxDetector(settings, ["bed"])
    with serving(KServe(nothing)) as server:
        inference_server = InferenceServer(url=server.url, model="m", time_limit_s=60)
        card = load_card_of(DetectCard, CARD).model_copy(
            update={"server": inference_server, "file": None}
        )
        monkeypatch.setattr("edge.perception.detection.onnx.load_detector_card", lambda name: card)
        remote = RemoteDetector(settings, card, ("bed",))
        benchmark.pedantic(remote.detect, (observation,), rounds=100, warmup_rounds=10)
        assert remote.health().state == "ok"
        remote.close()
    against(lambda: local.detect(observation))
