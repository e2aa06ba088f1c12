"""Surface points of instances. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

NEAR_M = 0.25
"""Points of two views this near to each other are of one surface."""
CORE_SHARE = 0.1
"""A surface that was seen in fewer than this share of the views may be another thing's."""

STRAY, LEAST_RADIUS_M = 1.6, 0.3
"""A point so many times farther from the middle than half of them, and this far, is what stands
before or behind the thing in its box."""


@njit(nogil=True, cache=True)
def merge_points(old, support, new, voxel_m, cap):
    """One point per voxel of both sets, at most `cap` spread evenly over the voxels' order.

    A point of `old` stays where it shares its voxel with one of `new`. Each point counts the views
    that showed something within NEAR_M of it; one of `new` begins with the count of its
    neighbourhood.

    Args:
        old: (k, 3) float32, support: (k,) int32, new: (m, 3) float32; k + m > 0, all finite.

    Returns:
        (points (n, 3) float32, their support (n,) int32).
    """
    k, total = len(old), len(old) + len(new)
    joined = np.empty((total, 3), np.float32)
    joined[:k] = old
    joined[k:] = new
    counts = np.ones(total, np.int32)
    counts[:k] = support
    for i in range(k):
        counts[i] += nearest(new, old[i, 0], old[i, 1]) <= NEAR_M
    for j in range(k, total):
        for i in range(k):
            dx, dy = joined[j, 0] - old[i, 0], joined[j, 1] - old[i, 1]
            if dx * dx + dy * dy <= NEAR_M * NEAR_M:
                counts[j] = max(counts[j], counts[i])
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
    points, views = np.empty((kept, 3), np.float32), np.empty(kept, np.int32)
    for j in range(kept):
        points[j] = joined[first[j * n // kept]]
        views[j] = counts[first[j * n // kept]]
    return points, views


@njit(nogil=True, cache=True)
def core_points(points, support):
    """The points of what most views show, so that one view of the wrong thing moves nothing,
    without those that lie astray.

    Args:
        points: (n, 3) float32, support: (n,) int32, from `merge_points`; n > 0.

    Returns:
        (points (m, 3) float32, their median (3,) float32, greatest planar distance from it).
    """
    most = support.max()
    least = max(min(2, most), CORE_SHARE * most)
    core = points[support >= least]
    center = np.empty(3, np.float32)
    for axis in range(3):
        center[axis] = np.median(core[:, axis])
    away = np.hypot(core[:, 0] - center[0], core[:, 1] - center[1])
    core = core[away <= max(LEAST_RADIUS_M, STRAY * np.median(away))]
    return core, center, farthest(core, center[0], center[1])


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
