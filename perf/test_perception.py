"""Benchmark: time of detection, back-projection and merging."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge import config
from edge.geometry import CameraModel, se3, to_optical
from edge.loop.warmup import warm_perception
from edge.perception.detection import kernels
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.masks.masker import Masker, make_segmenter
from edge.perception.runtime.cards import ModelError
from edge.perception.tracking.back_projection import BackProjector
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.types import Detections, Observation

SHARED_VOCABULARY = (
    Path(__file__).resolve().parents[2] / "shared" / "models" / "clip_vitb32_vocab.npz"
)
BACKGROUND = ("window", "door", "picture frame", "cabinet", "curtain", "person")
WORLD = {"model": "yolo-world-s-256x320-int8-cpu", "background": BACKGROUND}
OURS = {"model": "mini-house-256x320-int8-cpu"}


@pytest.fixture(scope="module", autouse=True)
def _warm():
    warm_perception()


def observe(seed=0, seq=0):
    """Return an observation: 640 × 480 noise, with depth that steps between near and far blocks."""
    random = np.random.default_rng(seed)
    depth = np.kron(random.uniform(0.5, 7, (12, 16)), np.ones((40, 40))).astype(np.float32)
    depth[random.random(depth.shape) < 0.05] = np.nan
    return Observation(
        seq=seq,
        stamp_ns=seq * 33_000_000,
        T_map_base=np.eye(4),
        rgb=random.integers(0, 256, (480, 640, 3), np.uint8),
        depth_m=depth,
        camera=CameraModel.from_hfov(640, 480, 1.3),
        T_base_camera=to_optical(se3(0.1, 0.0, 0.6)),
        cloud_m=random.uniform(-8, 8, (60000, 3)).astype(np.float32),
    )


WORDS = tuple(f"word{i}" for i in range(20))


def boxes_in(observation, n, seed=1, prompts=("chair", "sofa", "bed", "desk")):
    """Return n random detections, the highest score first."""
    random = np.random.default_rng(seed)
    corner = random.uniform(0, (480, 320), (n, 2))
    xyxy = np.hstack((corner, corner + random.uniform(40, 160, (n, 2)))).astype(np.float32)
    score = np.sort(random.uniform(0.05, 0.9, n).astype(np.float32))[::-1].copy()
    class_id = random.integers(0, len(prompts), n).astype(np.int32)
    return Detections(observation, xyxy, score, class_id, prompts)


def open_detector(model, **perception):
    """Return a detector of a model that is installed; else skip the benchmark."""
    vocabulary = str(SHARED_VOCABULARY) if SHARED_VOCABULARY.exists() else None
    chosen = config.DetectorOnnx(vocabulary=vocabulary, **model)
    try:
        return make_detector(config.PerceptionConfig(detector=chosen, **perception), ["chair"])
    except (ModelError, PromptError) as error:
        pytest.skip(str(error))


@pytest.fixture
def detector():
    return open_detector(WORLD)


@pytest.mark.benchmark(timer=time.perf_counter)
@pytest.mark.parametrize("isolation", ["thread", "process"])
@pytest.mark.parametrize("model", [WORLD, OURS], ids=["yolo-world", "mini-house"])
def test_detect_in_a_process(benchmark, isolation, model):
    """Compare a detection in a process of its own, on two threads, with one in a thread."""
    name = model["model"].partition("-256")[0]
    benchmark.extra_info["budget"] = f"detect_in_{isolation}_{name}"
    rules = config.ModelProcessConfig(timeout_s=60.0)
    detector = open_detector(model, isolation=isolation, process=rules)
    rgb = np.random.default_rng(0).integers(0, 256, (256, 320, 3), np.uint8)
    observation = Observation(0, 0, np.eye(4), rgb=rgb)
    benchmark.pedantic(detector.detect, (observation,), rounds=200, warmup_rounds=10)
    detector.close()


@pytest.mark.benchmark(timer=time.perf_counter)
def test_detect(benchmark, detector, against):
    """Compare an entire detection, on two threads, with a run of the network alone."""
    benchmark.extra_info["budget"] = "detect_int8_cpu_256x320"
    observation = observe()
    detector.detect(observation)
    against(detector._prompt_set.bound.run, time.perf_counter)
    benchmark.pedantic(detector.detect, (observation,), rounds=60, warmup_rounds=5)


def test_around_the_network(benchmark, detector):
    """Measure a detection without the run of the network: letterbox, scores, NMS."""
    benchmark.extra_info["budget"] = "detect_pre_and_post"
    observation = observe()
    detector.detect(observation)
    boxes, scores = detector._prompt_set.bound.run()

    def around():
        detector._fill_input(observation.rgb)
        return detector._select_boxes(detector._prompt_set, boxes[0], scores[0])

    benchmark(around)


def test_suppress(benchmark, against):
    """Compare decoding and NMS of 300 anchors above the threshold with OpenCV's NMS of these."""
    benchmark.extra_info["budget"] = "nms_1680_anchors"
    random = np.random.default_rng(0)
    n = 1680
    corner = random.uniform(0, 250, (n, 2))
    boxes = np.hstack((corner, corner + random.uniform(10, 90, (n, 2)))).astype(np.float32)
    scores = np.zeros((n, 7), np.float32)
    hot = random.choice(n, 300, replace=False)
    scores[hot] = random.uniform(0, 0.9, (300, 7)) ** 3
    anchor, label, keep = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(64, np.int32)
    score, top, tau = np.zeros(n, np.float32), np.zeros(n, np.float32), np.float32(0.05)
    competes, competing_score = np.ones((2, 1, 7), np.bool_), np.zeros(len(keep), np.float32)
    competes[:, 0, 0], cut = False, np.zeros(len(keep), np.bool_)

    def decode():
        m, _ = kernels.candidates(boxes, scores, 1, tau, 1e4, anchor, label, score, top)
        n = kernels.suppress(boxes, anchor, label, score, m, 0, 1, False, 0.5, keep)
        kernels.competing_scores(
            boxes, scores, competes, tau, top, anchor, label, keep, n, cut, 0.5, competing_score
        )
        return n

    lists = np.hstack((boxes[hot, :2], boxes[hot, 2:] - boxes[hot, :2])), scores[hot].max(axis=1)
    against(lambda: cv2.dnn.NMSBoxesBatched(*lists, scores[hot].argmax(axis=1), 0.05, 0.5))
    assert benchmark(decode) > 0


def test_grabcut(benchmark):
    """Measure the masks of eight boxes in a 640 × 480 image: objects of one colour, on noise."""
    benchmark.extra_info["budget"] = "grabcut_8_boxes"
    observation, settings = observe(), config.SegmenterGrabcut()
    found = boxes_in(observation, 8)
    for i, (x0, y0, x1, y1) in enumerate(found.xyxy_px.astype(int)):
        observation.rgb[y0 + 8 : y1 - 8, x0 + 8 : x1 - 8] = 20 + 25 * i
    masker = Masker(make_segmenter(settings), settings, timed=False)
    out = benchmark.pedantic(masker.add, (found,), rounds=40, warmup_rounds=3)
    assert out.mask.any()


@pytest.mark.parametrize("source", ["depth", "cloud"])
def test_back_projection(benchmark, source):
    """Measure the back-projection of twenty boxes of a 640 × 480 image."""
    benchmark.extra_info["budget"] = f"back_project_20_boxes_{source}"
    observation = observe()
    projector = BackProjector(
        config.PerceptionConfig(detector=config.DetectorSim(), back_projection=source)
    )
    out, _ = benchmark(projector.back_project, boxes_in(observation, 20))
    assert out.valid.any()


def test_track(benchmark):
    """Measure an update with eight boxes, and the check of all of some thirty known objects."""
    benchmark.extra_info["budget"] = "instances_update_8"
    perception = config.PerceptionConfig(detector=config.DetectorSim())
    tracker, projector = InstanceTracker(perception), BackProjector(perception)
    fusion = InstanceFusion(tracker)
    for seed in range(20):
        fusion.update(projector.back_project(boxes_in(observe(seed), 20, seed))[0], seed)
    observation = observe()
    projected, _ = projector.back_project(boxes_in(observation, 8))

    def step():
        fusion.update(projected, 1_000_000_000)
        fusion.expire(observation, projected.detections.prompts)

    benchmark(step)
    assert len(tracker) > 10


def test_objects(benchmark):
    """Measure an update with 8 target and 20 context boxes, among about 200 known objects."""
    benchmark.extra_info["budget"] = "objects_update_28"
    perception = config.PerceptionConfig(detector=config.DetectorSim())
    objects, projector = ObjectTracker(perception), BackProjector(perception)
    for seed in range(20):
        projected, _ = projector.back_project(boxes_in(observe(seed), 20, seed))
        objects.update(
            projected, projector.back_project(boxes_in(observe(seed), 20, seed + 100, WORDS))[0]
        )
    observation = observe()
    targets, _ = projector.back_project(boxes_in(observation, 8))
    around, _ = projector.back_project(boxes_in(observation, 20, 2, WORDS))
    benchmark(objects.update, targets, around)
    assert objects.read_only.n > 50


def test_five_thousand_objects(benchmark, against):
    """Compare the same update among 5,000 known objects on 3,600 m² and among 400, as dense."""
    benchmark.extra_info["budget"] = "objects_update_5000"
    observation, projector = (
        observe(),
        BackProjector(config.PerceptionConfig(detector=config.DetectorSim())),
    )
    boxes = (
        projector.back_project(boxes_in(observation, 8))[0],
        projector.back_project(boxes_in(observation, 20, 2, WORDS))[0],
    )
    few, many = (full_of(n) for n in (400, 5000))
    against(lambda: few.update(*boxes))
    benchmark(many.update, *boxes)
    assert many.read_only.n > 4900


def full_of(n):
    """Return a memory of n objects."""
    random, tracker = (
        np.random.default_rng(0),
        ObjectTracker(config.PerceptionConfig(detector=config.DetectorSim())),
    )
    side_m = 60.0 * (n / 5000) ** 0.5
    xyz_m = random.uniform(-side_m / 2, side_m / 2, (n, 3)).astype(np.float32)
    xyz_m[:, 2] = 0.5
    empty = tracker.state_dict()
    state = {name: np.zeros((n, *a.shape[1:]), a.dtype) for name, a in empty.items() if a.ndim}
    state |= {name: a for name, a in empty.items() if name.startswith("vanished")}
    state |= {"words": np.array(("chair", *WORDS)), "next_id": np.array(n + 1)}
    state["id"], state["xyz_m"] = np.arange(1, n + 1), xyz_m
    state["word"] = random.integers(0, len(WORDS) + 1, n).astype(np.int16)
    spread = random.uniform(-0.3, 0.3, state["points_m"].shape)
    state["points_m"] = (xyz_m[:, None] + spread).astype(np.float32)
    state["hits"][:], state["weight"][:], state["total"][:] = 5, 5.0, 3.0
    state["n_points"][:], state["confidence"][:] = state["points_m"].shape[1], 0.6
    tracker.load_state_dict(state, 0)
    return tracker
