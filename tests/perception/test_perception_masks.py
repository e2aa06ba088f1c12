"""Masks of boxes, and a segmenter that fails or is slow."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import twins
from frames import Slot
from hypothesis import given
from hypothesis import strategies as st
from patience import eventually

from edge import config
from edge.perception.masks.grabcut import GrabcutSegmenter
from edge.perception.masks.masker import Masker
from edge.perception.masks.segmenter import Deadline, rasterise
from edge.perception.runtime.health import ModelHealth
from edge.perception.worker import DetectorWorker
from edge.types import MASK_SIDE, Detections

GRABCUT = config.SegmenterGrabcut()
RED, BLUE, GREEN = (200, 40, 30), (40, 60, 200), (30, 160, 60)


def picture(*objects, hw=(64, 80), ground=BLUE):
    """Objects (colour, x0, y0, x1, y1) before a ground, each over those before it."""
    rgb = np.empty((*hw, 3), np.uint8)
    rgb[:] = ground
    for colour, x0, y0, x1, y1 in objects:
        rgb[y0:y1, x0:x1] = colour
    return rgb


def masks_of(rgb, *boxes, deadline=None):
    boxes = np.array(boxes, np.float32).reshape(-1, 4)
    out = np.zeros((len(boxes), MASK_SIDE, MASK_SIDE), np.bool_)
    done = GrabcutSegmenter().segment(rgb, boxes, out, Deadline(deadline))
    return done, out


def truth(rgb, colour, box):
    """Return the cells over a box whose middle shows a colour."""
    out = np.zeros((MASK_SIDE, MASK_SIDE), np.bool_)
    shows = (rgb == colour).all(axis=2) - np.float32(0.5)
    rasterise(shows, (0, 0), (1, 1), np.float32(box), out)
    return out


# -- rasters --------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1))
def test_a_raster_is_the_image_looked_up_cell_by_cell(seed):
    rng = np.random.default_rng(seed)
    values = rng.uniform(-1, 1, rng.integers(2, 20, 2)).astype(np.float32)
    origin, scale = tuple(rng.uniform(-9, 9, 2)), tuple(rng.uniform(0.2, 3, 2))
    corner = rng.uniform(-20, 40, 2)
    box = np.hstack([corner, corner + rng.uniform(1, 40, 2)]).astype(np.float32)
    out = np.zeros((MASK_SIDE, MASK_SIDE), np.bool_)
    rasterise(values, origin, scale, box, out)
    plain = twins.rasterised(values, origin, scale, box, MASK_SIDE)
    sure = np.abs(plain) > 0.05  # OpenCV looks between pixels in steps of a thirty-second
    np.testing.assert_array_equal(out[sure], (plain > 0)[sure])


# -- GrabCut --------------------------------------------------------------------------------------


def test_no_box_no_mask():
    assert masks_of(picture())[0] == 0


def test_a_mask_leaves_out_the_occluding_object():
    """A cabinet hides the lower left of a shelf and continues beyond its box."""
    rgb = picture((RED, 30, 10, 60, 50), (GREEN, 5, 30, 45, 55))
    box = (29, 9, 61, 51)
    _, (out,) = masks_of(rgb, box)
    wanted = truth(rgb, RED, box)
    assert (out & wanted).sum() > 0.9 * wanted.sum()
    assert (out & truth(rgb, GREEN, box)).sum() == 0


@pytest.mark.parametrize(
    "box",
    [(0, 0, 80, 64), (30, 20, 31, 21), (200, 200, 240, 240), (-90, -90, -50, -50)],
    ids=["the whole image", "a pixel", "beyond it", "before it"],
)
def test_without_background_or_object_the_mask_is_empty(box):
    done, out = masks_of(picture((RED, 30, 20, 50, 44)), box)
    assert done == 1
    assert not out.any()


def test_a_mask_of_a_small_part_is_rejected():
    """A lamp on a box is no mask of the box, which spans it."""
    rgb = picture((RED, 36, 28, 44, 36))
    assert not masks_of(rgb, (20, 10, 60, 54))[1].any()


def test_past_the_deadline_boxes_are_left():
    done, out = masks_of(picture((RED, 30, 20, 50, 44)), (26, 16, 54, 48), deadline=-1.0)
    assert done == 0
    assert not out.any()


@given(
    seed=st.integers(0, 2**32 - 1),
    box=st.tuples(*[st.floats(-200, 300, width=32)] * 2, *[st.floats(0.125, 400, width=32)] * 2),
)
def test_masks_are_repeatable_for_any_box(seed, box):
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 256, (*rng.integers(1, 40, 2), 3), np.uint8)
    x, y, wide, high = box
    one, other = (masks_of(noise, (x, y, x + wide, y + high)) for _ in range(2))
    assert one[0] == other[0] == 1
    np.testing.assert_array_equal(one[1], other[1])


# -- in the background ----------------------------------------------------------------------------


class Fake:
    """Segmenter that masks everything or raises a given error; `most` boxes are in time."""

    name = "fake"

    def __init__(self, error=None, most=99):
        self.error, self.most, self.closed, self.asked = error, most, False, []

    def segment(self, rgb, boxes, out, deadline):
        self.asked.append((boxes.tolist(), deadline.left_s()))
        if self.error is not None:
            raise self.error
        out[: self.most] = True
        return min(self.most, len(boxes))

    def close(self):
        self.closed = True


def found_in(observation, *boxes):
    n = len(boxes)
    xyxy, score = np.array(boxes, np.float32).reshape(n, 4), np.linspace(0.9, 0.5, n, dtype="f4")
    return Detections(observation, xyxy, score, np.zeros(n, np.int32), ("chair",), latency_ns=5)


@pytest.fixture
def seen(make_observation):
    return make_observation(rgb=picture((RED, 30, 20, 50, 44)))


def made(masks):
    return masks.any(axis=(1, 2)).tolist()


BOX = (26, 16, 54, 48)


@pytest.mark.parametrize(
    ("boxes", "fake", "masked", "counts"),
    [
        ([], Fake(), [], (0, 0)),
        ([BOX], Fake(), [True], (1, 0)),
        ([BOX] * 3, Fake(), [True, True, False], (2, 0)),
        ([BOX] * 2, Fake(most=1), [True, False], (1, 1)),
        ([(math.nan, 0, 1, 1), BOX], Fake(), [False, True], (1, 0)),
        ([(9, 9, 9, 30), BOX], Fake(), [False, True], (1, 0)),
        ([(-math.inf, 0, math.inf, 9)], Fake(), [False], (0, 0)),
    ],
)
def test_the_best_boxes_have_masks(seen, boxes, fake, masked, counts):
    limit_s = 600.0  # no busy computer uses it up
    masker = Masker(fake, GRABCUT.model_copy(update={"max_boxes": 2, "time_limit_s": limit_s}))
    found = masker.add(found_in(seen, *boxes))
    assert found.mask.shape == (len(boxes), MASK_SIDE, MASK_SIDE)
    assert made(found.mask) == masked
    assert (masker.n_masks, masker.n_skipped, masker.failed) == (*counts, 0)
    assert found.latency_ns > 5
    assert all(0 < left_s <= limit_s for _, left_s in fake.asked)


def test_detections_outlive_a_segmenter_that_fails(seen, caplog):
    masker = Masker(Fake(RuntimeError("no\nluck")), GRABCUT)
    for _ in range(2):
        found = masker.add(found_in(seen, BOX))
        assert made(found.mask) == [False]
    assert masker.status()["failed"] == 2
    assert masker.status()["last_error"] == "RuntimeError: no luck"
    assert len(caplog.messages) == 1
    assert "segmenter fake: RuntimeError: no luck; boxes are used without masks" in caplog.text


def test_an_observation_without_an_image_has_no_masks(make_observation):
    masker = Masker(GrabcutSegmenter(), GRABCUT)
    assert made(masker.add(found_in(make_observation(), BOX)).mask) == [False]
    assert "no camera image" in masker.last_error


class Finder:
    """A detector that finds one box."""

    name, prompts = "finder", ("chair",)

    def detect(self, observation):
        return found_in(observation, BOX)

    def health(self):
        return ModelHealth()

    def close(self): ...


@pytest.mark.parametrize("error", [None, RuntimeError("no luck")])
def test_the_detectors_worker_makes_masks_and_holds_the_frame_once(seen, error):
    seen = dataclasses.replace(seen, slot=Slot())
    fake = Fake(error)
    worker = DetectorWorker(Finder(), masker=Masker(fake, GRABCUT))
    worker.submit(seen)
    eventually(lambda: worker.idle)
    found = worker.poll()
    assert made(found.mask) == [error is None]
    assert seen.slot.holds == 1  # held by the caller of poll
    worker.close()
    assert fake.closed


def test_masks_go_with_their_boxes(seen):
    found = found_in(seen, BOX, BOX)
    masks = np.zeros((2, MASK_SIDE, MASK_SIDE), np.bool_)
    masks[1] = True
    found = dataclasses.replace(found, mask=masks, competing_score=np.array([1, 0], np.float32))
    assert made(found.without_suppressed().mask) == [True]
