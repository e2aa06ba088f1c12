"""Recall of the detector, against the pixels that the simulator knows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from edge.lab.eval.recall import RecallCounter, visible_boxes
from edge.types import Detections, Observation

TARGETS = {"sofa": np.array([False, True, True])}  # objects 1 and 2


def image(*boxes: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return ids and depths of an image in which object k fills the k-th box."""
    ids, depth_m = np.zeros((60, 80), np.uint16), np.full((60, 80), 2.0, np.float32)
    for k, (x0, y0, x1, y1) in enumerate(boxes, start=1):
        ids[y0:y1, x0:x1] = k
    return ids, depth_m


def detections(*boxes: tuple[str, float, tuple[int, int, int, int]]) -> Detections:
    words = tuple(dict.fromkeys(word for word, *_ in boxes)) or ("sofa",)
    return Detections(
        Observation(seq=0, stamp_ns=0, T_map_base=np.eye(4)),
        np.array([box for *_, box in boxes], np.float32).reshape(-1, 4),
        np.array([score for _, score, _ in boxes], np.float32),
        np.array([words.index(word) for word, *_ in boxes], np.int32),
        words,
    )


SOFA, FAR = (10, 10, 40, 30), (50, 40, 70, 55)
CASES = {
    "nothing there": ((), (), (0, 0)),
    "nothing found": ((SOFA,), (), (1, 0)),
    "found": ((SOFA,), (("sofa", 0.5, SOFA),), (1, 1)),
    "by another name for it": ((SOFA,), (("couch", 0.5, SOFA),), (1, 1)),
    "one of two": ((SOFA, FAR), (("sofa", 0.5, FAR),), (2, 1)),
    "another object": ((SOFA,), (("bed", 0.5, SOFA),), (1, 0)),
    "a weak box": ((SOFA,), (("sofa", 0.1, SOFA),), (1, 0)),
    "a box elsewhere": ((SOFA,), (("sofa", 0.5, (30, 10, 60, 30)),), (1, 0)),
    "a speck": (((1, 1, 9, 9),), (("sofa", 0.5, (1, 1, 9, 9)),), (0, 0)),
    "no target": (((0, 0, 0, 0), (0, 0, 0, 0), SOFA), (("sofa", 0.5, SOFA),), (0, 0)),
}


@pytest.mark.parametrize("case", CASES)
def test_views_are_counted(case):
    objects, found, expected = CASES[case]
    counter = RecallCounter(tau_det=0.25)
    counter.update(detections(*found), visible_boxes(*image(*objects), 5.0, 3), TARGETS)
    assert (counter.views, counter.detected) == expected


@given(
    arrays.arrays(np.uint16, (6, 7), elements=st.integers(0, 4)),
    arrays.arrays(np.float32, (6, 7), elements=st.sampled_from((1.0, 9.0, np.nan))),
)
def test_visible_boxes_agree_with_numpy(ids, depth_m):
    boxes = visible_boxes(ids, depth_m, 5.0, 4)
    assert boxes[0].tolist() == [0] * 5
    for k in range(1, 4):
        v, u = np.nonzero((ids == k) & (depth_m <= 5.0))
        plain = [u.min(), v.min(), u.max() + 1, v.max() + 1, len(u)] if len(u) else [0] * 5
        assert boxes[k].tolist() == plain
