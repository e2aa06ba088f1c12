"""The measures of the small detector, on cases with known answers."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from exporters.mini import looks
from exporters.mini.evaluate import _average_precision, _counts, _match, _questions
from exporters.mini.views import OBJECT, WIDTH_PX

CHAIR = 1 + looks.CATEGORIES.index("chair")
ARMCHAIR = 1 + looks.CATEGORIES.index("armchair")


def things(*rows) -> np.ndarray:
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


def test_no_things_no_questions():
    assert _questions(things()) == []
    assert len(_counts(things())) == 0


def test_two_of_a_kind_are_asked_for_by_what_differs():
    pair = things((CHAIR, (0, 0, 40, 40), "red", "tall"), (CHAIR, (60, 0, 100, 40), "blue", "tall"))
    asked = [(q.kind, tuple(q.phrase), q.right, q.wrong) for q in _questions(pair)]
    red, blue = (1 + looks.COLORS.index(c) for c in ("red", "blue"))
    assert asked == [("color", (CHAIR, red, 0), 0, 1), ("color", (CHAIR, blue, 0), 1, 0)]


@pytest.mark.parametrize(
    ("x1", "kind"), [(100, "size"), (WIDTH_PX, "cut_off_size")], ids=["whole", "cut off"]
)
def test_sizes_are_asked_apart_where_a_thing_is_cut_off(x1, kind):
    pair = things((CHAIR, (10, 10, 40, 90), None, "tall"), (CHAIR, (60, 10, x1, 50), None, "short"))
    assert [(q.kind, q.right, q.wrong) for q in _questions(pair)] == [(kind, 0, 1), (kind, 1, 0)]


def test_small_and_hidden_things_do_not_count():
    some = things((CHAIR, (0, 0, 11, 40), "red", None), (CHAIR, (0, 0, 12, 40), "red", None))
    assert _counts(some).tolist() == [False, True]
    some["visible"] = 0.49
    assert not _counts(some).any()


def test_a_second_box_on_a_thing_is_wrong_and_one_on_a_maybe_is_left_out():
    some = things(
        (CHAIR, (0, 0, 40, 40), "red", None), (ARMCHAIR, (100, 100, 140, 140), "red", None)
    )
    boxes = np.array(
        [[0, 0, 40, 40], [0, 0, 40, 79], [100, 100, 140, 140], [200, 0, 240, 40]], np.float32
    )
    scores = np.array([0.9, 0.8, 0.7, 0.6], np.float32)
    found = _match(boxes, scores, some, _counts(some), CHAIR)
    assert found == [(pytest.approx(0.9), 1), (pytest.approx(0.6), 0)] or found == [
        (pytest.approx(0.9), 1), (pytest.approx(0.8), 0), (pytest.approx(0.6), 0)
    ]  # fmt: skip
