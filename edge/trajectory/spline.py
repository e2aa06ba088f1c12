"""Uniform cubic B-splines: smooth curves beside a polyline."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import BSpline

_FINER = 8
"""Length along the curve is measured by chords so many times shorter than its points' distance,"""
_SHORT = 1.001
"""which makes it shorter than it is by less than this."""


def b_spline(control_m: np.ndarray, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """The curve that control points pull along, from the first of them to the last.

    Its speed and its bend change without a jump, and each of its points lies in the hull of four
    control points in a row: the nearer they stand, the nearer the curve keeps to their polyline.

    Args:
        control_m: (n, d) float64; both ends count three times, so that the curve begins and ends
            there.
        spacing_m: points of the curve are at most as far apart, and equally far along it.

    Returns:
        (k, d) float64, and (k,) int64: for each, the control point before it.
    """
    n = len(control_m)
    if n < 2:
        return control_m.copy(), np.zeros(n, np.int64)
    padded = control_m[np.clip(np.arange(-2, n + 2), 0, n - 1)]
    curve = BSpline(np.arange(n + 8.0), padded, 3)  # its pieces are [3, 4] to [n + 3, n + 4]
    # A hull of four is no longer than its three legs, and the curve takes at most the longest.
    longest = np.sqrt((np.diff(control_m, axis=0) ** 2).sum(axis=1).max())
    pieces = max(1, math.ceil(longest / spacing_m)) * _FINER
    fine = np.linspace(3.0, n + 4.0, (n + 1) * pieces + 1)
    chords = np.sqrt((np.diff(curve(fine), axis=0) ** 2).sum(axis=1))
    along_m = np.append(0.0, np.cumsum(chords))
    even_m = np.linspace(0.0, along_m[-1], max(1, math.ceil(_SHORT * along_m[-1] / spacing_m)) + 1)
    u = np.interp(even_m, along_m, fine)
    points = curve(u)
    points[[0, -1]] = control_m[[0, -1]]  # not but for rounding
    return points, np.clip(np.floor(u).astype(np.int64) - 4, 0, n - 1)
