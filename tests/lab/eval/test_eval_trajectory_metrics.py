"""Trajectory metrics: known answers, and properties of all trajectories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geometry import Grid
from edge.lab.eval.trajectory_metrics import (
    FRECHET_M,
    contacts,
    frechet_m,
    navigation_error_m,
    ndtw,
    point_contacts,
    resample_evenly,
)
from edge.trajectory.smoothing import resample

POINT = st.tuples(*[st.floats(-3, 3).map(lambda x: round(x, 3))] * 2)
PATH = st.lists(POINT, min_size=1, max_size=7).map(lambda points: np.array(points))
LINE = [[0, 0], [10, 0]]


def path(points) -> np.ndarray:
    return np.reshape(np.array(points, float), (-1, 2))


@pytest.mark.parametrize("measure", [navigation_error_m, frechet_m, ndtw])
@pytest.mark.parametrize("bad", [[], [[math.nan, 0.0]], [[0.0, math.inf]]])
def test_an_invalid_trajectory_is_refused(measure, bad):
    with pytest.raises(ValueError, match="expected at least one point"):
        measure(path(bad), path(LINE))
    with pytest.raises(ValueError, match="expected at least one point"):
        measure(path(LINE), path(bad))


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([[1, 2]], [[1, 2]], 0.0),
        ([[0, 0]], [[3, 4]], 5.0),
        (LINE, [[0, 0], [4, 0], [4, 0], [10, 0]], 0.0),
        (LINE, [[5, 0]], 5.0),
        # A detour to the side; a loop that a dog may run while its owner waits in the middle.
        (LINE, [[0, 0], [5, 3], [10, 0]], 3.0),
        # Alt & Godau's own difference from Hausdorff's distance, which is 1 here.
        ([[0, 0], [10, 0], [0, 1], [10, 1]], [[0, 0], [10, 1]], math.hypot(5, 0.5)),
        # The owner passes the dog between two of its points.
        ([[0, 0], [9.3, 0]], [[0, 0], [3.17, 2], [9.3, 0]], 2.0),
    ],
)
def test_frechet(a, b, expected):
    assert frechet_m(path(a), path(b)) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    ("a", "reference", "expected"),
    [
        ([[1, 2]], [[1, 2]], 1.0),
        ([[3, 4]], [[0, 0]], math.exp(-5.0)),
        (LINE, LINE, 1.0),
        # 21 points each, all 2 m from their partner: exp(-21 * 2 / 21).
        ([[0, 2], [10, 2]], LINE, math.exp(-2.0)),
        # A single point against 21: the mean distance is 2.5 m and 1/84 of it more.
        ([[5, 0]], LINE, math.exp(-2 * sum(0.5 * k for k in range(11)) / 21)),
        # The reference is one point: all are matched with it, and |R| is 1.
        ([[0, 0], [1, 0]], [[0, 0]], math.exp(-(0.0 + 0.5 + 1.0))),
    ],
)
def test_ndtw(a, reference, expected):
    assert ndtw(path(a), path(reference)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("a", "clearance_m", "expected"),
    [
        ([[-5, 0]], 0.0, 0),
        ([[0, 0]], 0.0, 1),
        ([[-5, 0], [5, 0]], 0.0, 1),
        # In and out, and in again; along the side, and nearer than the robot is wide.
        ([[-5, 0], [5, 0], [-5, 0.5]], 0.0, 2),
        ([[-5, 1.2], [5, 1.2]], 0.0, 0),
        ([[-5, 1.2], [5, 1.2]], 0.4, 1),
        ([[-50, -50], [-40, -50]], 0.4, 0),
        ([[0, 0], [50, 0]], 0.0, 1),
    ],
)
def test_contacts(a, clearance_m, expected):
    grid = Grid(np.zeros((100, 100), np.int8), (-10.0, -10.0), 0.2)
    grid.cells[45:55, 45:55] = 100  # from -1 to 1
    assert contacts(path(a), grid, clearance_m) == expected


def frechet_twin(a: np.ndarray, b: np.ndarray) -> float:
    """Eiter & Mannila's recursion, as it is written, at points half a metre apart."""
    a, b = resample(a, 0.5), resample(b, 0.5)
    d = np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))
    reach = np.full(d.shape, math.inf)
    for i, j in np.ndindex(d.shape):
        before = [
            reach[k, m] for k, m in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(k, m) >= 0
        ]
        reach[i, j] = max(d[i, j], min(before, default=0.0))
    return float(reach[-1, -1])


def ndtw_twin(a: np.ndarray, reference: np.ndarray) -> float:
    a, reference = resample_evenly(a, 0.5), resample_evenly(reference, 0.5)
    d = np.hypot(*(reference[:, None] - a[None]).transpose(2, 0, 1))
    total = np.full(np.add(d.shape, 1), math.inf)
    total[0, 0] = 0.0
    for i, j in np.ndindex(d.shape):
        total[i + 1, j + 1] = d[i, j] + min(total[i, j + 1], total[i + 1, j], total[i, j])
    return math.exp(-total[-1, -1] / len(reference))


@given(PATH, PATH)
def test_frechet_agrees_with_the_twin(a, b):
    """The twin is too long by at most half a metre."""
    coarse = frechet_twin(a, b)
    assert coarse - 0.5 - 1e-9 <= frechet_m(a, b) <= coarse + FRECHET_M


@given(PATH, PATH)
def test_ndtw_agrees_with_the_twin(a, reference):
    assert ndtw(a, reference) == pytest.approx(ndtw_twin(a, reference))


@given(PATH, PATH, PATH)
def test_frechet_is_a_metric(a, b, c):
    ab = frechet_m(a, b)
    assert frechet_m(a, a) == 0.0
    assert frechet_m(b, a) == pytest.approx(ab, abs=1e-9)
    assert frechet_m(a[::-1], b[::-1]) == pytest.approx(ab, abs=1e-9)
    assert ab <= frechet_m(a, c) + frechet_m(c, b) + 2 * FRECHET_M
    assert ab >= max(math.dist(a[0], b[0]), math.dist(a[-1], b[-1])) - 1e-9


@given(PATH, POINT)
def test_frechet_of_a_shifted_path_is_the_shift(a, shift):
    assert frechet_m(a, a + shift) == pytest.approx(math.hypot(*shift), abs=1e-9)


@given(PATH, PATH)
def test_ndtw_is_1_for_the_same_and_less_for_others(a, b):
    assert ndtw(a, a) == 1.0
    assert 0.0 <= ndtw(a, b) <= 1.0
    if ndtw(a, b) == 1.0:
        # Corners between two points are not looked at.
        assert frechet_m(a, b) <= 0.5


@pytest.mark.parametrize(
    ("solid", "expected", "depth_m"),
    [([], 0, 0.0), ([[5.0, 1.1]], 0, 0.0), ([[5.0, 0.9]], 1, 0.1),
     ([[5.0, 0.9], [5.5, -0.7]], 1, 0.3), ([[2.0, 0.9], [8.0, 0.0]], 2, 1.0)],
)  # fmt: skip
def test_contacts_with_points_have_their_exact_depth(solid, expected, depth_m):
    solid_m, driven = np.array(solid, np.float64).reshape(-1, 2), path([[0, 0], [10, 0]])
    assert point_contacts(driven, solid_m, 1.0) == (expected, pytest.approx(depth_m))
