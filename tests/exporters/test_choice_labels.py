"""Labels of views from stored distances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from edge.perception.runtime.card_types import MARK_FIELDS
from edge.perception.scoring.choice.question import MAX_MARKS
from exporters.training.choice import labels
from exporters.training.choice.collect import BEFORE, NEVER, NOW, Views

INF = np.inf


def views_of(rows: list[dict]) -> Views:
    n = len(rows)
    marks = np.zeros((n, MAX_MARKS, 4), np.float32)
    path_m = np.zeros((n, MAX_MARKS), np.float32)
    left_m = np.full((n, MAX_MARKS, 1), INF, np.float32)
    for i, row in enumerate(rows):
        k = len(row["left"])
        marks[i, :k] = (159.5, 127.5, 0.1, 3.0)
        path_m[i, :k], left_m[i, :k, 0] = row["path"], row["left"]

    def each(name: str, default: float) -> np.ndarray:
        return np.array([[row.get(name, default)] for row in rows], np.float32).reshape(n, 1)

    return Views(
        np.empty(n, object), np.arange(n, dtype=np.int32),
        np.array([len(row["left"]) for row in rows], np.uint8), marks, path_m,
        2.0 * path_m, np.zeros((n, 3), np.float32), left_m,
        each("else_m", INF), each("else_path_m", INF), each("here_m", INF),
        each("seen", NEVER).astype(np.uint8), np.ones((n, MAX_MARKS, 1), np.float32),
    )  # fmt: skip


def test_without_views_there_are_no_labels():
    empty = views_of([])
    assert labels.marks_of(empty).shape == (0, MAX_MARKS, MARK_FIELDS)
    assert labels.is_asked(empty).shape == labels.scene(empty).shape == (0, 1)


def test_marks_are_image_fractions_padded_with_zeros():
    found = labels.marks_of(views_of([{"left": [2.0], "path": [1.0]}]))
    np.testing.assert_allclose(found[0, 0], [0.5, 0.5, 0.1, 3.0, 1.0, 2.0, 1.0], rtol=1e-6)
    assert not found[0, 1:].any()


@pytest.mark.parametrize(
    ("row", "asked"),
    [
        ({"left": [2.0], "path": [1.0], "seen": NEVER}, True),
        ({"left": [2.0], "path": [1.0], "seen": NOW}, True),
        ({"left": [2.0], "path": [1.0], "seen": BEFORE}, False),
        ({"left": [INF], "path": [1.0]}, False),  # the house has none
        ({"left": [INF], "path": [1.0], "else_m": 4.0}, True),
    ],
)
def test_views_with_a_known_or_absent_target_are_skipped(row, asked):
    assert labels.is_asked(views_of([row])).item() is asked


@pytest.mark.parametrize(
    ("left", "else_m", "expected"),
    [
        ([2.0], INF, [1.0, 0.0]),
        ([INF], 2.0, [0.0, 1.0]),
        ([2.0, 2.0], INF, [0.5, 0.5, 0.0]),
        ([2.0, 2.0 + labels.SOFT_M], INF, [1 / (1 + np.exp(-1)), 1 / (1 + np.e), 0.0]),
    ],
)
def test_directions_are_weighted_by_the_distance_left(left, else_m, expected):
    found = labels.directions(np.array(left), np.array(else_m))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@given(hnp.arrays(np.float64, st.integers(2, 9), elements=st.floats(0, 100)))
def test_directions_sum_to_one_and_favour_the_shortest(each_m):
    found = labels.directions(each_m[:-1], each_m[-1])
    assert found.sum() == pytest.approx(1.0, abs=1e-5)
    assert found[each_m.argmin()] == found.max()


@pytest.mark.parametrize(
    ("row", "leads"),
    [
        ({"left": [8.0], "path": [2.0], "here_m": 10.0}, True),
        ({"left": [8.0], "path": [4.0], "here_m": 10.0}, True),  # a detour of a fifth
        ({"left": [8.0], "path": [5.0], "here_m": 10.0}, False),
        ({"left": [1.0], "path": [2.0], "here_m": 1.6}, True),  # 1.4 m of a detour
        ({"left": [9.0, 8.0], "path": [9.0, 2.0], "here_m": 10.0}, True),
        ({"left": [8.0], "path": [9.0], "here_m": 12.0, "else_path_m": 10.0}, False),
    ],
)
def test_the_scene_leads_to_marks_near_a_shortest_path(row, leads):
    assert labels.scene(views_of([row])).item() is leads
