"""Numba kernels of the decoders. They know arrays only."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def keep_finite(points_m: np.ndarray, n: int) -> int:
    """Move the points without NaN or inf among the first `n` of (cap, 3) to the front.

    Returns:
        How many there are; their order is kept.
    """
    kept = 0
    for i in range(n):
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
            points_m[kept, 0] = x
            points_m[kept, 1] = y
            points_m[kept, 2] = z
            kept += 1
    return kept


@njit(nogil=True, cache=True)
def scan_points(
    ranges_m: np.ndarray,
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    range_max_m: float,
    out_m: np.ndarray,
) -> int:
    """The beams of a planar scan that hit something, as points (x, y, 0) in `out_m` (cap, 3).

    Returns:
        How many there are; `cap` must be at least the number of beams.
    """
    n = 0
    for i in range(ranges_m.shape[0]):
        r = ranges_m[i]
        if r >= range_min_m and r < range_max_m:
            angle = angle_min_rad + i * angle_increment_rad
            out_m[n, 0] = r * math.cos(angle)
            out_m[n, 1] = r * math.sin(angle)
            out_m[n, 2] = 0.0
            n += 1
    return n


def warmup() -> None:
    """Compile both kernels for what the decoders hand them (a payload is read-only)."""
    points_m = np.zeros((2, 3), np.float32)
    ranges_m = np.frombuffer(bytes(8), np.float32)
    keep_finite(points_m, 2)
    scan_points(ranges_m, 0.0, 0.1, 0.1, 1.0, points_m)
