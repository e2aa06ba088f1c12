from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge import config
from edge.perception.detection.sim import Segmentation
from edge.tasks.scene.pipeline import (
    PerceptionPipeline,
    boxes_as_masks,
    in_tiles,
    open_pipeline,
    run_pipeline,
)
from edge.types import MASK_SIDE, Detections, Observation


def observe(width=40, height=20):
    rgb = np.zeros((height, width, 3), np.uint8)
    return Observation(1, 0, np.eye(4), rgb=rgb)


def detections(observation, boxes=(), words=("car",), score=0.9, class_id=0):
    n = len(boxes)
    return Detections(
        observation, np.array(boxes, np.float32).reshape(n, 4), np.full(n, score, np.float32),
        np.full(n, class_id, np.int32), tuple(words),
    )  # fmt: skip


def chain_of(*boxes, **parts):
    given = {
        "tags": lambda observation: ("car", "tree"),
        "boxes": lambda observation, tags: detections(observation, boxes, tags),
        "masks": boxes_as_masks,
    }
    return PerceptionPipeline(**{**given, **parts})


def test_each_stage_gets_the_result_of_the_previous_one():
    """Eq. 1: TAP(I, GD(I, RAM(I)))."""
    observation, calls = observe(), []

    def tags(image):
        calls.append("tags")
        assert image is observation
        return ("tree", "van")

    def boxes(image, words):
        calls.append("boxes")
        assert image is observation
        return detections(image, [(0, 0, 5, 5)], words, class_id=1)

    def masks(found):
        calls.append("masks")
        return replace(found, mask=np.ones((1, MASK_SIDE, MASK_SIDE), np.bool_))

    def captions(found):
        calls.append("captions")
        assert found.mask.all()
        return [f"a {found.prompts[found.class_id[0]]}"]

    seen = run_pipeline(PerceptionPipeline(tags, boxes, masks, captions), observation)
    assert calls == ["tags", "boxes", "masks", "captions"]
    assert seen.caption == ("a van",)


def test_a_wrong_count_of_captions_is_an_error():
    with pytest.raises(ValueError, match="1 boxes, but 0 captions"):
        run_pipeline(chain_of((0, 0, 5, 5), captions=lambda found: []), observe())


def looker(objects, seen):
    """Return a detector of partly visible objects, from left to right in pixels.

    The image's columns contain the object's number.
    """

    def boxes(observation, tags):
        columns = observation.rgb[0, :, 0].astype(int)
        seen.append(len(columns))
        found = []
        for x0, x1 in objects:
            inside = np.flatnonzero((columns >= x0) & (columns < x1))
            if len(inside):
                found.append((inside[0], 2, inside[-1] + 1, 18))
        return detections(observation, found, tags)

    return boxes


def numbered(width):
    observation = observe(width)
    observation.rgb[:, :, 0] = np.arange(width)
    return observation


def test_an_object_across_two_tiles_is_one_box():
    """Parts of 27 px overlap; the object across two of them is cut in both."""
    seen = []
    objects = [(3, 10), (15, 40), (70, 78)]
    observation = numbered(80)
    found = in_tiles(looker(objects, seen), 4 / 3)(observation, ("car",))
    assert seen[0] == 80
    assert set(seen[1:]) == {27}
    assert found.observation is observation
    assert sorted((int(x0), int(x1)) for x0, _, x1, _ in found.xyxy_px) == objects


def test_two_words_on_one_place_are_two_boxes():
    def boxes(observation, tags):
        return Detections(
            observation, np.array([[0, 0, 9, 9], [0, 0, 9, 9]], np.float32),
            np.array([0.9, 0.8], np.float32), np.array([0, 1], np.int32), ("car", "van"),
        )  # fmt: skip

    found = in_tiles(boxes)(observe(80), ("car", "van"))
    firsts = [k for x0, k in zip(found.xyxy_px[:, 0], found.class_id, strict=True) if x0 == 0]
    assert firsts == [0, 1]


def test_a_configured_chain_takes_the_detectors_boxes():
    """The simulator's detector: words that it is not told of are not found."""
    ids = np.zeros((20, 40), np.uint16)
    ids[5:15, 10:30] = 1
    truth = Segmentation(ids, ("chair",))
    perception = config.PerceptionConfig(
        detector=config.DetectorSim(miss_rate=0.0, false_positive_rate=0.0), tau_det=0.1
    )
    observation = replace(observe(), depth_m=np.full((20, 40), 2.0, np.float32))
    with open_pipeline(perception, ("chair", "sofa"), lambda stamp_ns: truth) as chain:
        seen = run_pipeline(chain, observation)
    assert [seen.found.prompts[k] for k in seen.found.class_id] == ["chair"]
    assert seen.caption == ("black chair",)
    np.testing.assert_allclose(seen.found.xyxy_px[0], [10, 5, 30, 15], atol=1.0)
