"""Uniform cubic B-splines: smooth curves beside a polyline."""

from __future__ import annotations

import math

import numpy as np

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
    # A hull of four is no longer than its three legs, and the curve takes at most the longest.
    longest = np.sqrt((np.diff(control_m, axis=0) ** 2).sum(axis=1).max())
    pieces = max(1, math.ceil(longest / spacing_m)) * _FINER
    fine = np.linspace(0.0, n + 1.0, (n + 1) * pieces + 1)
    chords = np.sqrt((np.diff(_curve(padded, fine), axis=0) ** 2).sum(axis=1))
    along_m = np.append(0.0, np.cumsum(chords))
    even_m = np.linspace(0.0, along_m[-1], max(1, math.ceil(_SHORT * along_m[-1] / spacing_m)) + 1)
    u = np.interp(even_m, along_m, fine)
    points = _curve(padded, u)
    points[[0, -1]] = control_m[[0, -1]]  # not but for rounding
    return points, np.clip(np.floor(u).astype(np.int64) - 1, 0, n - 1)


def _curve(control_m: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(k, d) where control points (n, d) have the curve at u (k,), from 0 to n - 3.

    The blending functions of a uniform cubic B-spline. SciPy's would be imported by each process
    that has to do with a service, for longer than all else that it imports of ours.
    """
    piece = np.clip(np.floor(u).astype(np.int64), 0, len(control_m) - 4)
    t = u - piece
    weights = (1.0 - t) ** 3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 3.0 * (t + t**2 - t**3) + 1.0, t**3
    return sum(w[:, None] * control_m[piece + k] for k, w in enumerate(weights)) / 6.0
