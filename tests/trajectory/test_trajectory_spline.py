"""B-splines: their ends, their hull and the spacing of their points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from edge.trajectory.spline import b_spline

CONTROLS = st.lists(st.tuples(*[st.floats(-50, 50)] * 2), min_size=2, max_size=12).map(np.array)


def test_a_corner_is_rounded_by_a_sixth():
    """At its knot the curve is 1/6, 4/6, 1/6 of three control points."""
    control = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0]])
    curve, at = b_spline(control, 0.001)
    np.testing.assert_allclose(curve[np.argmax(at == 2)], [(1 + 8 + 2) / 6, 1 / 6], atol=0.001)


@given(CONTROLS, st.floats(0.05, 5.0))
def test_its_points_are_on_the_curve_of_scipy(control, spacing_m):
    n = len(control)
    points, _ = b_spline(control, spacing_m)
    padded = control[np.clip(np.arange(-2, n + 2), 0, n - 1)]
    theirs = BSpline(np.arange(n + 8.0), padded, 3)(np.linspace(3.0, n + 4.0, 2000 * n))
    longest_m = np.hypot(*np.diff(control, axis=0).T).max()
    off_m, _ = cKDTree(theirs).query(points)
    assert off_m.max() <= 1e-3 * longest_m


@given(CONTROLS, st.floats(0.05, 5.0))
def test_ends_hull_and_spacing(control, spacing_m):
    curve, at = b_spline(control, spacing_m)
    np.testing.assert_allclose(curve[[0, -1]], control[[0, -1]], atol=1e-9)
    assert (curve >= control.min(axis=0) - 1e-9).all()
    assert (curve <= control.max(axis=0) + 1e-9).all()
    assert np.hypot(*np.diff(curve, axis=0).T).max() <= spacing_m * (1 + 1e-9)
    assert (np.diff(at) >= 0).all()
