"""The parity figures, on boxes small enough to count by hand."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

from exporters.files import ExportError
from exporters.parity import INT8_LIMITS, ParityReport, compare, select_boxes

pytestmark = pytest.mark.export

A = (0.0, 0.0, 10.0, 10.0)
A_SHIFTED = (1.0, 0.0, 11.0, 10.0)  # IoU with A: 9 / 11
FAR = (50.0, 50.0, 60.0, 60.0)
IMAGE = np.zeros((1, 3, 32, 32), np.float32)
TEXT = np.zeros((1, 2, 512), np.float32)
NAN = float("nan")


def model(xyxy_px: list, scores: list):
    """Return a detector with a constant answer."""
    answer = np.array([xyxy_px], np.float32).reshape(1, -1, 4), np.array([scores], np.float32)
    return lambda images, txt_feats: answer


@pytest.mark.parametrize(
    ("xyxy_px", "scores", "kept"),
    [
        pytest.param([], np.empty((0, 2)), [], id="no anchors"),
        pytest.param([A], [[0.1, 0.3]], [], id="threshold is exclusive"),
        pytest.param([A, A_SHIFTED], [[0.5, 0.0], [0.9, 0.0]], [(0.9, 0)], id="best of a pair"),
        pytest.param([A, FAR], [[0.5, 0], [0.9, 0]], [(0.9, 0), (0.5, 0)], id="best first"),
        pytest.param([A], [[0.5, 0.6]], [(0.6, 1), (0.5, 0)], id="classes do not suppress"),
    ],
)
def test_select_boxes(xyxy_px, scores, kept):
    found = select_boxes(
        np.array(xyxy_px, np.float32).reshape(-1, 4), np.array(scores, np.float32), 0.3
    )
    pairs = zip(found.score, found.class_id, strict=True)
    assert [(pytest.approx(s), c) for s, c in kept] == list(pairs)


def test_compare_without_images():
    report = compare(model([A], [[0.9, 0]]), model([A], [[0.9, 0]]), [], TEXT)
    assert (report.images, report.detections, report.recall) == (0, 0, 1.0)
    assert report.figures()["score_error"] is None


def test_compare_counts_lost_new_and_moved_scores():
    reference = model([A, FAR], [[0.9, 0.0], [0.4, 0.1]])
    candidate = model([A, FAR], [[0.8, 0.5], [0.2, 0.15]])
    report = compare(reference, candidate, [IMAGE, IMAGE], TEXT)
    assert (report.images, report.detections) == (2, 4)
    assert report.recall == 0.5  # FAR fell below the threshold
    assert report.precision == 0.5  # A is also seen as class 1
    assert report.score_error == pytest.approx(0.5)  # only 0.1 → 0.15 is in the band
    assert report.max_abs_diff == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("candidate", "says"),
    [
        pytest.param(
            model([A, FAR], [[0.9, 0.1], [NAN, NAN]]), "scores of image 1: 2 of 4", id="score"
        ),
        pytest.param(
            model([A, (np.inf,) * 4], [[0.9, 0.1], [0, 0]]), "boxes of image 1: 4 of 8", id="box"
        ),
    ],
)
def test_a_model_with_values_that_are_not_finite_is_refused(candidate, says):
    """This also holds if every box of the reference is found."""
    sound = model([A, FAR], [[0.9, 0.1], [0.0, 0.0]])
    for pair, which in (((sound, candidate), "candidate"), ((candidate, sound), "reference")):
        with pytest.raises(ExportError, match=f"the {which}'s {says}"):
            compare(*pair, [IMAGE], TEXT)


def test_a_missing_score_error_is_none_in_the_card():
    assert report(score_error=NAN).for_card("fp32")["score_error"] is None
    assert report().for_card("fp32")["score_error"] == 0.1


def report(**changed: float) -> ParityReport:
    figures = {"images": 3, "detections": 5, "recall": 1.0, "precision": 1.0}
    figures |= {"score_error": 0.1, "max_abs_diff": 0.1}
    return ParityReport(**(figures | changed))


@pytest.mark.parametrize(
    ("changed", "more", "text"),
    [
        ({"recall": 0.9}, {}, "recall 0.9 < 0.95"),
        ({"precision": 0.5}, {}, "precision 0.5 < 0.8"),
        ({"score_error": 0.2}, {"score_error": 0.1}, "score_error 0.2 > 0.1"),
        ({"detections": 0}, {}, "detects nothing above 0.3"),
        ({"recall": NAN}, {}, "recall nan < 0.95"),
        ({"score_error": NAN}, {"score_error": 0.1}, "score_error nan > 0.1"),
        ({"max_abs_diff": NAN}, {"max_abs_diff": 0.1}, "max_abs_diff nan > 0.1"),
    ],
)
def test_the_parity_error_names_the_violated_limit(changed, more, text):
    limits = {**INT8_LIMITS, **more}
    report().accept("card", "torch", limits)
    with pytest.raises(ExportError, match="card: ") as caught:
        report(**changed).accept("card", "torch", limits)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
