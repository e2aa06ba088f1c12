"""The measures of the small detector, on cases with known answers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from edge import config
from edge.lab.bench.boxes import overlaps
from exporters.files import ExportError
from exporters.training.mini import evaluate, looks
from exporters.training.mini.evaluate import (
    DEPLOYED,
    IOU,
    Report,
    _average_precision,
    _does_count,
    _match,
    _questions,
    check_gate,
)
from exporters.training.mini.views import OBJECT, WIDTH_PX, Frames

CHAIR = 1 + looks.CATEGORIES.index("chair")
ARMCHAIR = 1 + looks.CATEGORIES.index("armchair")


def objects(*rows) -> np.ndarray:
    made = np.zeros(len(rows), OBJECT)
    for row, (category, box, rgb, style) in zip(made, rows, strict=True):
        row["category"], row["box"], row["visible"] = category, box, 1.0
        row["color"] = looks.color_answers(looks.PALETTE[rgb]) if rgb else looks.unsure_color()
        row["size"] = looks.size_answers(style, "chair")
    return made


@pytest.mark.parametrize(
    ("found", "count", "ap"),
    [
        ([], 3, 0.0),
        ([(0.9, 1)], 1, 1.0),
        ([(0.9, 0), (0.8, 1)], 1, 0.5),
        ([(0.9, 1), (0.8, 0), (0.7, 1)], 2, 0.5 + 0.5 * 2 / 3),
        ([(0.7, 0), (0.9, 1)], 2, 0.5),
    ],
)
def test_average_precision(found, count, ap):
    assert _average_precision(found, count) == pytest.approx(ap)


def test_questions_tell_two_objects_apart_by_their_difference():
    assert _questions(objects()) == []
    pair = objects(
        (CHAIR, (0, 0, 40, 40), "red", "tall"), (CHAIR, (60, 0, 100, 40), "blue", "tall")
    )
    asked = [(q.kind, tuple(q.phrase), q.right, q.wrong) for q in _questions(pair)]
    red, blue = (1 + looks.COLORS.index(c) for c in ("red", "blue"))
    assert asked == [("color", (CHAIR, red, 0), 0, 1), ("color", (CHAIR, blue, 0), 1, 0)]


@pytest.mark.parametrize(
    ("x1", "kind"), [(100, "size"), (WIDTH_PX, "cut_off_size")], ids=["whole", "cut off"]
)
def test_size_questions_about_cut_off_objects_have_their_own_kind(x1, kind):
    pair = objects(
        (CHAIR, (10, 10, 40, 90), None, "tall"), (CHAIR, (60, 10, x1, 50), None, "short")
    )
    assert [(q.kind, q.right, q.wrong) for q in _questions(pair)] == [(kind, 0, 1), (kind, 1, 0)]


def test_small_and_hidden_objects_do_not_count():
    some = objects((CHAIR, (0, 0, 11, 40), "red", None), (CHAIR, (0, 0, 12, 40), "red", None))
    assert _does_count(some).tolist() == [False, True]
    some["visible"] = 0.49
    assert not _does_count(some).any()


def test_a_second_box_is_wrong_and_a_maybe_is_ignored():
    some = objects(
        (CHAIR, (0, 0, 40, 40), "red", None), (ARMCHAIR, (100, 100, 140, 140), "red", None)
    )
    boxes = np.array(
        [[0, 0, 40, 70], [0, -30, 40, 40], [100, 100, 140, 140], [200, 0, 240, 40]], np.float32
    )
    assert overlaps(boxes[:1], boxes[1:2])[0] < IOU, "both stay, though they are on one object"
    scores = np.array([0.9, 0.8, 0.7, 0.6], np.float32)
    found = _match(boxes, scores, some, _does_count(some), CHAIR)
    assert found == [(pytest.approx(0.9), 1), (pytest.approx(0.8), 0), (pytest.approx(0.6), 0)]


def report(**changed) -> Report:
    pairs = {"color": (9, 10), "size": (3, 5), "cut_off_size": (0, 40)}
    phrases = np.tile([[DEPLOYED + 0.1, DEPLOYED - 0.1]], (15, 1))
    figures = {"ap50": {"chair": 0.5, "bed": 1.0}, "n_objects": {"chair": 3, "bed": 1}}
    figures |= {"pairs": pairs, "phrases": phrases, "latency_ms": (5.0, 6.0)}
    return Report(**(figures | changed))


def test_the_summary_says_of_how_many_questions_its_shares_are():
    summary = report().summary()
    assert summary["ap50"] == 0.75
    assert summary["things"] == 4
    kinds = {"color": (0.9, 10), "size": (0.6, 5), "cut_off_size": (0.0, 40)}
    for kind, (share, asked) in kinds.items():
        assert (summary[f"{kind}_pairs"], summary[f"{kind}_questions"]) == (share, asked)
    assert summary["pairs_told_apart"] == 0.8, "nobody can tell the size of what is cut off"


def test_phrases_are_judged_at_the_services_threshold():
    assert config.load("demo").perception.tau_det == DEPLOYED
    summary = report(phrases=np.array([[0.9, 0.1], [0.29, 0.2], [0.31, 0.3]])).summary()
    assert summary["right_above_0.3"] == pytest.approx(0.667)
    assert summary["wrong_below_0.3"] == 1.0


def test_without_questions_no_share_is_reached():
    nothing = dict.fromkeys(("color", "size", "cut_off_size"), (0, 0))
    empty = report(pairs=nothing, phrases=np.empty((0, 2)))
    assert empty.pair_share() == 0.0
    assert empty.summary()["color_questions"] == 0


def test_only_questions_with_an_answer_go_into_the_phrases(monkeypatch):
    """One question about colour and one about the size of a cut-off object."""
    pair = objects(
        (CHAIR, (10, 10, 40, 90), "red", "tall"), (CHAIR, (60, 10, WIDTH_PX, 50), "blue", "short")
    )
    frames = Frames(np.zeros((1, 256, WIDTH_PX, 3), np.uint8), pair, np.array([0, 2]))
    monkeypatch.setattr(evaluate, "cpu_session", lambda path, threads: FakeModel(pair["box"]))
    monkeypatch.setattr(evaluate, "_latency", lambda *args: (1.0, 1.0))
    measured = evaluate.measure(Path("detector.onnx"), Path("text.onnx"), frames)
    assert measured.pairs["color"][1] == measured.pairs["cut_off_size"][1] == 2
    assert measured.phrases.shape == (2, 2)


class FakeModel:
    """Text rows of zeros, and the given boxes with the same score for every phrase."""

    def __init__(self, boxes: np.ndarray) -> None:
        self.boxes = boxes

    def run(self, _, feed):
        if "tokens" in feed:
            return [np.zeros((len(feed["tokens"]), 4), np.float32)]
        prompts = feed["txt_feats"].shape[1]
        return [self.boxes[None], np.full((1, len(self.boxes), prompts), 0.5, np.float32)]


@pytest.mark.parametrize(
    ("changed", "step", "says"),
    [
        ({}, 10, None),
        ({}, 9, "trained only 9 of 10 steps"),
        ({"ap50": 0.69}, 10, "ap50 0.69 < 0.7"),
        ({"ap50": float("nan")}, 10, "ap50 nan < 0.7"),
        ({"pairs_told_apart": 0.5}, 10, "pairs_told_apart 0.5 < 0.8"),
        ({"bytes": 2_900_001}, 10, "2900001 bytes > 2900000"),
    ],
)
def test_the_gate(changed, step, says):
    figures = {"ap50": 0.7, "pairs_told_apart": 0.8, "bytes": 2_900_000} | changed
    if says is None:
        check_gate(figures, step, 10)
        return
    with pytest.raises(ExportError, match=re.escape(says)) as caught:
        check_gate(figures, step, 10)
    assert "\n" not in str(caught.value)
