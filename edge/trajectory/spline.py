"""Uniform cubic B-splines: smooth curves beside a polyline."""

from __future__ import annotations

import math

import numpy as np

# Cubic basis: weights of four control points in a row, by powers of the way between two knots.
_BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0


def b_spline(control_m: np.ndarray, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """The curve that control points pull along, from the first of them to the last.

    Its speed and its bend change without a jump, and each of its points lies in the hull of four
    control points in a row: the nearer they stand, the nearer the curve keeps to their polyline.

    Args:
        control_m: (n, d) float64; both ends count three times, so that the curve begins and ends
            there.
        spacing_m: points of the curve are at most as far apart.

    Returns:
        (k, d) float64, and (k,) int64: for each, the control point before it.
    """
    n = len(control_m)
    if n < 2:
        return control_m.copy(), np.zeros(n, np.int64)
    padded = control_m[np.clip(np.arange(-2, n + 2), 0, n - 1)]
    fours = np.stack([padded[k : k + n + 1] for k in range(4)], axis=1)
    # A hull of four is no longer than its three legs, and the curve takes at most the longest.
    longest = np.sqrt((np.diff(control_m, axis=0) ** 2).sum(axis=1).max())
    pieces = max(1, math.ceil(longest / spacing_m))
    powers = (np.arange(pieces) / pieces)[:, None] ** np.arange(4)
    curve = np.einsum("pw,wk,nkd->npd", powers, _BASIS, fours).reshape(-1, control_m.shape[1])
    curve[0] = control_m[0]  # not but for rounding
    at = np.clip(np.repeat(np.arange(n + 1), pieces) - 1, 0, n - 1)
    return np.concatenate([curve, control_m[-1:]]), np.append(at, n - 1)
