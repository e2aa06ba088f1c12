"""What was seen where, fused over time. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

from edge.perception.tracking.look_kernels import HIDDEN, WHOLE, ahead_m, shown

POINTS = 32
"""Surface points kept of each sighting."""
_TAKEN = 6
"""Points of a view that are taken up at most: later views bring others."""
PARTIAL = 0.25
"""What a look counts that does not show a thing as a whole."""
FORGET = 40.0
"""Weight at which what was seen is halved, so that the old fades."""
SAME_M = 0.2
"""Surface points so near to each other (along each axis) are of one surface."""
WITHIN = 0.5
"""A thing with that share of its surface on another's may be that other; less of it, less so."""
PRIOR = 0.5
"""Weight of the doubt that a confidence starts with: one look convinces nobody."""


@njit(nogil=True, cache=True)
def match(centers, points, n_points, word, n, of_word, x, y, merge_m):
    """The record of a word that lies nearest to a place, -1 where none is within `merge_m`.

    Args:
        centers: (cap, 3) float32, points: (cap, POINTS, 3) float32 of which the first `n_points[i]`
            of record i count, word: (cap,) int16; the first `n` records count.
        of_word: of the thing, at (x, y) in `map`.
    """
    best, least = -1, merge_m * merge_m
    for i in range(n):
        if word[i] != of_word:
            continue
        dx, dy = centers[i, 0] - x, centers[i, 1] - y
        d = dx * dx + dy * dy
        for k in range(n_points[i]):
            dx, dy = points[i, k, 0] - x, points[i, k, 1] - y
            d = min(d, dx * dx + dy * dy)
        if d < least:
            best, least = i, d
    return best


@njit(nogil=True, cache=True)
def drifted(centers, word, n, now, near_m):
    """Two records of one word whose middles have come within `near_m`: of one thing, seen from
    either end before from the middle.

    Args:
        centers, word, n: see `match`; now: (cap,) float32, over 0 where this image showed it.

    Returns:
        (lower, higher) index, of which one was seen now; (-1, -1): there are none.
    """
    for i in range(n):
        if now[i] <= 0.0:
            continue
        for j in range(n):
            if j == i or word[j] != word[i]:
                continue
            dx, dy = centers[i, 0] - centers[j, 0], centers[i, 1] - centers[j, 1]
            if dx * dx + dy * dy < near_m * near_m:
                return min(i, j), max(i, j)
    return -1, -1


@njit(nogil=True, cache=True)
def take_up(points, n_points, cursor, i, surface, n_surface, voxel_m):
    """Add some points of a new view to record `i`: one a voxel; over POINTS the oldest go.

    Args:
        points, n_points: see `match`; cursor: (cap,) int32, where the next one goes.
        surface: (k, 3) float32 in `map`, the first `n_surface` count.
    """
    step = max(1, n_surface // _TAKEN)
    for j in range(0, n_surface, step):
        known = False
        for k in range(n_points[i]):
            apart = 0.0
            for axis in range(3):
                apart = max(apart, abs(points[i, k, axis] - surface[j, axis]))
            if apart < voxel_m:
                known = True
                break
        if known:
            continue
        at = cursor[i]
        for axis in range(3):
            points[i, at, axis] = surface[j, axis]
        cursor[i] = (at + 1) % POINTS
        n_points[i] = min(n_points[i] + 1, POINTS)


@njit(nogil=True, cache=True)
def weight_of(x, y, z, points, n_points, T_camera_map, view, depth, near_m, far_m):
    """What a look counts for a thing: 1 near by and whole in the image, less with the square of
    the distance, as the share of the image that a thing fills; 0 where its middle is not in view.

    Args:
        x, y, z, points, n_points, T_camera_map, view, depth: see `look_kernels.shown`.
        near_m, far_m: full weight up to there; none from there.
    """
    how = shown(x, y, z, points, n_points, T_camera_map, view, depth, far_m)
    if how == HIDDEN:
        return 0.0
    share = min(1.0, (near_m / ahead_m(T_camera_map, x, y, z)) ** 2)
    return share if how == WHOLE else PARTIAL * share


@njit(nogil=True, cache=True)
def fuse(
    centers, points, n_points, word, n, now, asked, T_camera_map, view, depth, near_m, far_m,
    weight, total, confidence,
):  # fmt: skip
    """One look at every record: what was detected is its evidence, what was not speaks against it.

    Args:
        centers, points, n_points, word, n: see `match`.
        now: (cap,) float32, the score of each record in this image, 0 where not detected; zeroed.
        asked: (words,) bool, what the detector looked for.
        T_camera_map, view, depth: see `look_kernels.shown`; near_m, far_m: see `weight_of`.
        weight, total: (cap,) float32, sums of weights, and of weights times scores.
        confidence: (cap,) float32 out.
    """
    for i in range(n):
        if not asked[word[i]]:
            now[i] = 0.0
            continue
        w = weight_of(
            centers[i, 0], centers[i, 1], centers[i, 2], points[i], n_points[i], T_camera_map,
            view, depth, near_m, far_m,
        )  # fmt: skip
        if now[i] > 0.0:  # it was seen, whatever hides its middle
            w = max(w, PARTIAL * PARTIAL)
        if w > 0.0:
            weight[i] += w
            total[i] += w * now[i]
            if weight[i] > FORGET:
                weight[i] *= 0.5
                total[i] *= 0.5
            confidence[i] = total[i] / (weight[i] + PRIOR)
        now[i] = 0.0


@njit(nogil=True, cache=True)
def strongest_rival(surface, centers, points, n_points, word, confidence, n, against, reach_m):
    """How sure it is that something else stands where a thing was seen.

    A record speaks for what it covers of the thing: a row of chairs for all of a sofa, a pillow
    for little of a bed. One that lies for the most part elsewhere, as the table under a vase does,
    says little; records of one word speak together.

    Args:
        surface: (k, 3) float32 in `map`, the thing's; k > 0.
        centers, points, n_points, word, confidence, n: the records, see `match`.
        against: (words,) float32, what each word's confidence counts; 0: it names the same thing.
        reach_m: how far records' middles may lie from the surface's.

    Returns:
        The highest mean, over the surface, of the confidences of a word's records that cover it.
    """
    k = len(surface)
    x, y = np.mean(surface[:, 0]), np.mean(surface[:, 1])
    told = np.zeros(len(against), np.bool_)
    cover = np.zeros((len(against), k), np.float32)
    for i in range(n):
        dx, dy = centers[i, 0] - x, centers[i, 1] - y
        if against[word[i]] == 0.0 or n_points[i] == 0 or dx * dx + dy * dy > reach_m * reach_m:
            continue
        on = np.zeros(k, np.bool_)
        inside = 0
        for j in range(n_points[i]):
            lies = False
            for s in range(k):
                if (
                    abs(points[i, j, 0] - surface[s, 0]) < SAME_M
                    and abs(points[i, j, 1] - surface[s, 1]) < SAME_M
                    and abs(points[i, j, 2] - surface[s, 2]) < SAME_M
                ):
                    on[s] = True
                    lies = True
            inside += lies
        share = min(1.0, inside / (WITHIN * n_points[i]))
        told[word[i]] = True
        for s in range(k):
            if on[s]:
                cover[word[i], s] = max(cover[word[i], s], share * confidence[i])
    best = np.float32(0.0)
    for w in range(len(against)):
        if told[w]:
            best = max(best, against[w] * np.mean(cover[w]))
    return best
