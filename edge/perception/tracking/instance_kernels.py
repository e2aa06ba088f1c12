"""Kernels that merge, filter and measure the surface points of an instance. Arrays only."""

from __future__ import annotations

import numpy as np

from edge.jit import jit

NEAR_M = 0.25
"""Points of two views that are at most this far apart belong to one surface."""
CORE_SHARE = 0.1
"""A point with less than this share of the largest support may belong to another object."""

# A point farther from the centre than both limits is dropped: it belongs to an object in front of
# this one or behind it.
STRAY = 1.6  # limit as a multiple of the median distance from the centre
LEAST_RADIUS_M = 0.3


@jit
def merge_points(old, support, new, voxel_m, max_points):
    """Merge two point sets into one point per voxel, at most `max_points` in all.

    If there are more voxels, points are taken at equal steps in the order of the voxels. A point of
    `old` wins over one of `new` in the same voxel. Each point of `old` counts one more view if a
    point of `new` is within NEAR_M in the plane. A point of `new` starts with 1, or with the
    highest count of its neighbours in `old`.

    Args:
        old: (k, 3) float32, finite; k + m > 0.
        support: (k,) int32, number of views of each point of `old`.
        new: (m, 3) float32, finite.
        voxel_m: side of a voxel.
        max_points: largest number of points.

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
    # Key of a voxel: its three numbers in 21 bits each, shifted so that none is negative.
    keys = np.empty(total, np.int64)
    for i in range(total):
        key = np.int64(0)
        for axis in range(3):
            key = (key << 21) | (np.int64(np.floor(joined[i, axis] / voxel_m)) + (1 << 20))
        keys[i] = key
    order = np.argsort(keys, kind="mergesort")  # stable: `old` stays before `new` in a voxel
    first = np.empty(total, np.int64)  # index of the first point of each voxel
    n = 0
    for j in range(total):
        if j == 0 or keys[order[j]] != keys[order[j - 1]]:
            first[n] = order[j]
            n += 1
    kept = min(n, max_points)
    points, views = np.empty((kept, 3), np.float32), np.empty(kept, np.int32)
    for j in range(kept):
        points[j] = joined[first[j * n // kept]]
        views[j] = counts[first[j * n // kept]]
    return points, views


@jit
def core_points(points, support):
    """Return the well-supported points, without stray ones.

    A point needs the support of two views, if any point has that, and CORE_SHARE of the largest
    support. So one view of the wrong object moves nothing.

    Args:
        points: (n, 3) float32, from `merge_points`; n > 0.
        support: (n,) int32, from `merge_points`.

    Returns:
        Points (m, 3) float32, their median (3,) float32, and the greatest planar distance of a
        point from the median.
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


@jit
def farthest(points, x, y):
    """Return the greatest planar distance from (x, y) to (n, 3) points."""
    most = 0.0
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        most = max(most, dx * dx + dy * dy)
    return np.sqrt(most)


@jit
def nearest(points, x, y):
    """Return the least planar distance from (x, y) to (n, 3) points; inf if there are none."""
    least = np.inf
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        least = min(least, dx * dx + dy * dy)
    return np.sqrt(least)


@jit
def least_gap(points, others):
    """Return the least planar distance between (n, 3) and (m, 3) points, and the rows of the two.

    The distance is inf if a set is empty.
    """
    least, row, other_row = np.inf, 0, 0
    for i in range(len(points)):
        for j in range(len(others)):
            dx, dy = points[i, 0] - others[j, 0], points[i, 1] - others[j, 1]
            if dx * dx + dy * dy < least:
                least, row, other_row = dx * dx + dy * dy, i, j
    return np.sqrt(least), row, other_row
