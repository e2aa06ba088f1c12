from __future__ import annotations

import numpy as np
import pytest

from edge import config
from edge.perception.detection.sim import Segmentation
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector

LABELS = ("ChairA", "sofa", "Trash")


def ids_and_depth(distance_m=2.0):
    """Return a chair left, a sofa right, and a distant bin of few pixels between."""
    ids, depth = np.zeros((64, 80), np.uint16), np.full((64, 80), 4.0, np.float32)
    ids[20:50, 5:30], ids[25:55, 45:78], ids[30:34, 36:40] = 1, 2, 3
    depth[ids == 1], depth[ids == 2], depth[ids == 3] = distance_m, 3.0, 7.9
    return ids, depth


def scene(distance_m=2.0):
    return {"depth_m": ids_and_depth(distance_m)[1]}


def make(prompts=("chair",), labels=LABELS, **settings):
    quiet = {"miss_rate": 0.0, "false_positive_rate": 0.0, "score_noise": 0.0} | settings
    perception = config.PerceptionConfig(detector=config.DetectorSim(**quiet))
    seen = Segmentation(ids_and_depth()[0], labels)
    return make_detector(perception, prompts, truth=lambda stamp_ns: seen)


@pytest.mark.parametrize("prompts", [(), ("",), ("chair", " ")])
def test_empty_prompts_are_refused(prompts):
    with pytest.raises(PromptError, match="prompt"):
        make(prompts)


@pytest.mark.parametrize(
    ("labels", "boxes"),
    [
        (("ChairA", "sofa", "Trash"), 1),  # no "dog chair" in this world: a chair will do
        (("dog chair", "chair", "Trash"), 1),
        (("lamp", "sofa", "dog chair"), 0),  # the one that there is cannot be seen from here
    ],
)
def test_an_exact_name_matches_before_its_noun(make_observation, labels, boxes):
    found = make(("dog chair",), labels).detect(make_observation(**scene()))
    assert len(found) == boxes


@pytest.mark.parametrize(
    ("prompts", "classes"),
    [
        (("bed",), []),
        (("chair",), [0]),
        (("couch",), [0]),
        (("sofa", "chair"), [0, 1]),
        (("big red chair near the door",), [0]),
        (("garbage can",), []),  # too small and too far
    ],
)
def test_objects_answer_to_their_names(make_observation, prompts, classes):
    found = make(prompts).detect(make_observation(**scene()))
    assert sorted(found.class_id) == classes
    assert (np.diff(found.score) <= 0).all()
    assert found.prompts == prompts


def test_the_same_seed_and_frame_replay_the_same(make_observation):
    noisy = {"miss_rate": 0.3, "false_positive_rate": 0.3, "score_noise": 0.2, "seed": 5}
    frames = [make_observation(seq=i, **scene()) for i in range(40)]
    first = [make(**noisy).detect(f) for f in frames]
    second = [make(**noisy).detect(f) for f in reversed(frames)][::-1]  # order does not matter
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.score, b.score)
        np.testing.assert_array_equal(a.xyxy_px, b.xyxy_px)
    other = [make(**noisy | {"seed": 6}).detect(f).score.tolist() for f in frames]
    assert other != [d.score.tolist() for d in first]


def test_misses_and_false_positives_have_the_configured_rates(make_observation):
    frames = [make_observation(seq=i, **scene()) for i in range(400)]
    detector = make(miss_rate=0.2)
    seen = sum(len(detector.detect(f)) for f in frames)
    assert 0.55 < seen / 400 < 0.8  # 0.2 · (1 + 2 · 2/6) are missed
    mistaken = make(("bed",), false_positive_rate=0.1)
    wrong = [d for f in frames for d in mistaken.detect(f).score]
    assert 30 < len(wrong) < 130  # two visible objects in 400 frames
    assert max(wrong) < 0.5


@pytest.mark.parametrize("missing", ["segmentation", "simulator", "depth_m"])
def test_without_a_simulator_the_error_names_onnx(make_observation, missing):
    truth = {"segmentation": lambda stamp_ns: None, "simulator": None}
    sim = config.PerceptionConfig(detector=config.DetectorSim())
    detector = make() if missing == "depth_m" else make_detector(sim, ["x"], truth=truth[missing])
    seen = {} if missing == "depth_m" else scene()
    with pytest.raises(ValueError, match=r"no segmentation .*kind: onnx"):
        detector.detect(make_observation(**seen))


@pytest.mark.parametrize(
    ("prompts", "background", "words", "classes"),
    [
        (("bed",), (), (), []),
        (("bed",), None, ("chair", "sofa", "trash can"), [0, 1]),
        (("chair",), None, ("sofa", "trash can"), [0]),
        (("couch",), None, ("chair", "trash can"), [0]),
        (("bed",), ("couch", "sofa", "lamp"), ("sofa", "table lamp"), [0]),
        (("furniture", "chair"), ("armchair", "sofa"), ("sofa",), [0]),
    ],
)
def test_background_objects_are_context(make_observation, prompts, background, words, classes):
    context = make(prompts, background=background).detect(make_observation(**scene())).context
    assert context.words == words
    assert sorted(context.class_id) == classes
    assert context.class_id.dtype == np.int32
    assert (np.diff(context.score) <= 0).all()


def test_context_changes_nothing_about_the_targets(make_observation):
    noisy = {"miss_rate": 0.3, "false_positive_rate": 0.3, "score_noise": 0.2}
    frames = [make_observation(seq=i, **scene()) for i in range(40)]
    bare, full = make(**noisy, background=()), make(**noisy)
    for frame in frames:
        without, found = bare.detect(frame), full.detect(frame)
        np.testing.assert_array_equal(found.score, without.score)
        np.testing.assert_array_equal(found.xyxy_px, without.xyxy_px)
        np.testing.assert_array_equal(found.class_id, without.class_id)
