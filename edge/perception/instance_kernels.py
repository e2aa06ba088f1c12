"""Surface points of instances. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def merge_points(old, new, voxel_m, cap):
    """One point per voxel of both sets, at most `cap` spread evenly over the voxels' order.

    A point of `old` stays where it shares its voxel with one of `new`.

    Args:
        old: (k, 3) float32, new: (m, 3) float32; k + m > 0, all finite.

    Returns:
        (points (n, 3) float32, their median (3,) float32, greatest planar distance from it).
    """
    k, total = len(old), len(old) + len(new)
    joined = np.empty((total, 3), np.float32)
    joined[:k] = old
    joined[k:] = new
    keys = np.empty(total, np.int64)
    for i in range(total):
        key = np.int64(0)
        for axis in range(3):
            key = (key << 21) | (np.int64(np.floor(joined[i, axis] / voxel_m)) + (1 << 20))
        keys[i] = key
    order = np.argsort(keys, kind="mergesort")
    first = np.empty(total, np.int64)
    n = 0
    for j in range(total):
        if j == 0 or keys[order[j]] != keys[order[j - 1]]:
            first[n] = order[j]
            n += 1
    kept = min(n, cap)
    points = np.empty((kept, 3), np.float32)
    for j in range(kept):
        points[j] = joined[first[j * n // kept]]
    center = np.empty(3, np.float32)
    for axis in range(3):
        center[axis] = np.median(points[:, axis])
    return points, center, farthest(points, center[0], center[1])


@njit(nogil=True, cache=True)
def farthest(points, x, y):
    """Greatest planar distance from (x, y) to (n, 3) points."""
    most = 0.0
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        most = max(most, dx * dx + dy * dy)
    return np.sqrt(most)


@njit(nogil=True, cache=True)
def nearest(points, x, y):
    """Least planar distance from (x, y) to (n, 3) points; inf when there are none."""
    least = np.inf
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        least = min(least, dx * dx + dy * dy)
    return np.sqrt(least)
