"""Uniform cubic B-splines: smooth curves along a polyline."""

from __future__ import annotations

import math

import numpy as np

_CHORDS_PER_SPACING = 8
"""The curve's length is measured with chords this many times shorter than the point spacing."""
_MAX_CHORD_RATIO = 1.001
"""Largest ratio of the curve's length to the sum of the chords."""


def b_spline(control_m: np.ndarray, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points on the B-spline of some control points, from the first to the last of them.

    The curve has no jump in speed or curvature. Each of its points is in the convex hull of four
    consecutive control points, so closer control points keep the curve closer to their polyline.

    Args:
        control_m: (n, d) float64. Both ends count three times, so the curve begins and ends there.
        spacing_m: largest distance between two points; the points are equally spaced along the
            curve.

    Returns:
        (k, d) float64 points, and (k,) int64: for each point the index of the control point before
        it.
    """
    n = len(control_m)
    if n < 2:
        return control_m.copy(), np.zeros(n, np.int64)
    # Both ends three times. At parameter u the curve is then nearest to control point u - 1.
    padded = control_m[np.clip(np.arange(-2, n + 2), 0, n - 1)]
    # Between two control points the curve is no longer than the longest leg of its hull.
    longest = np.sqrt((np.diff(control_m, axis=0) ** 2).sum(axis=1).max())
    pieces = max(1, math.ceil(longest / spacing_m)) * _CHORDS_PER_SPACING
    fine = np.linspace(0.0, n + 1.0, (n + 1) * pieces + 1)
    chords = np.sqrt((np.diff(_curve(padded, fine), axis=0) ** 2).sum(axis=1))
    along_m = np.append(0.0, np.cumsum(chords))
    even_m = np.linspace(
        0.0, along_m[-1], max(1, math.ceil(_MAX_CHORD_RATIO * along_m[-1] / spacing_m)) + 1
    )
    u = np.interp(even_m, along_m, fine)
    points = _curve(padded, u)
    points[[0, -1]] = control_m[[0, -1]]  # without rounding errors
    return points, np.clip(np.floor(u).astype(np.int64) - 1, 0, n - 1)


def _curve(control_m: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the (k, d) points of the curve at parameters u (k,) in [0, n - 3].

    These are the blending functions of a uniform cubic B-spline for control points (n, d). SciPy
    has them too, but its import would take longer than all other imports of a service.
    """
    piece = np.clip(np.floor(u).astype(np.int64), 0, len(control_m) - 4)
    t = u - piece
    weights = (1.0 - t) ** 3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 3.0 * (t + t**2 - t**3) + 1.0, t**3
    return sum(w[:, None] * control_m[piece + k] for k, w in enumerate(weights)) / 6.0
