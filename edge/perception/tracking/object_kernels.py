"""Kernels of the object map (`object_tracker`): they match and fuse its rows. Arrays only."""

from __future__ import annotations

import numpy as np

from edge.jit import jit
from edge.perception.tracking.look_kernels import HIDDEN, WHOLE, ahead_m, visibility
from edge.perception.tracking.place_index import move, rows_near

POINTS = 32
"""Number of surface points kept of each row, that is, of each object."""
_POINTS_PER_VIEW = 6
"""About this many points of a view are added, evenly spread: later views bring others."""
PARTIAL = 0.25
"""Factor on the weight of a view that does not show the object as a whole."""
FORGET = 40.0
"""Sum of weights at which the evidence is halved, so that old evidence fades."""
SAME_M = 0.2
"""Surface points at most this far apart (along each axis) belong to one surface."""
WITHIN = 0.5
"""Share of a row's points that must lie on another object's surface, to count fully against it.

With a smaller share the row counts in proportion."""
PRIOR = 0.5
"""Weight of an assumed first view with score 0: one view alone gives no high confidence."""


@jit
def match(centers, points, n_points, reach, word, rows, of_word, x, y, merge_m):
    """Return the row of a word that is nearest to a place, -1 if none is within `merge_m`.

    Args:
        centers: (cap, 3) float32 in `map`.
        points: (cap, POINTS, 3) float32 in `map`; the first `n_points[i]` of row i count.
        n_points: (cap,) int32.
        reach: (cap,) float32, see `reach_of`.
        word: (cap,) int16, index of each row's word.
        rows: (k,) int32, the rows that may match.
        of_word: index of the word to match.
        x: x of the place in `map`.
        y: y of the place in `map`.
        merge_m: largest planar distance.
    """
    best, least = -1, merge_m * merge_m
    for i in rows:
        if word[i] != of_word:
            continue
        dx, dy = centers[i, 0] - x, centers[i, 1] - y
        d = dx * dx + dy * dy
        if d >= (merge_m + reach[i]) ** 2:  # no surface point can be near enough
            continue
        for k in range(n_points[i]):
            dx, dy = points[i, k, 0] - x, points[i, k, 1] - y
            d = min(d, dx * dx + dy * dy)
        if d < least:
            best, least = i, d
    return best


@jit
def match_near(
    index, n, search_m, near, centers, points, n_points, reach, word, of_word, x, y, merge_m
):  # fmt: skip
    """Return `match`, with its arguments, among the rows near a place.

    - `index`: see `place_index.PlaceIndex`.
    - `n`: number of rows.
    - `search_m`: distance of the place from the farthest centre that may match.
    - `near`: (cap,) int32, scratch.
    """
    k = rows_near(index, n, x, y, search_m, near)
    return match(centers, points, n_points, reach, word, near[:k], of_word, x, y, merge_m)


@jit
def reach_of(centers, points, n_points, i):
    """Return the largest planar distance of row `i`'s points from its centre, rounded up."""
    most = 0.0
    for k in range(n_points[i]):
        dx, dy = points[i, k, 0] - centers[i, 0], points[i, k, 1] - centers[i, 1]
        most = max(most, dx * dx + dy * dy)
    return np.sqrt(most) + 1e-3


@jit
def find_duplicate(index, centers, word, n, now, near_m, rows):
    """Find two rows of one word whose centres are closer than `near_m`.

    Such rows are one object that was first seen from its two ends. See `match_near` for the other
    arguments.

    - `now`: (cap,) float32, above 0 if the object was detected in this image.
    - `rows`: (cap,) int32, scratch.

    Returns:
        (lower, higher) index of such a pair, at least one of them detected in this image; (-1, -1):
        there is none.
    """
    for i in range(n):
        if now[i] <= 0.0:
            continue
        for at in range(rows_near(index, n, centers[i, 0], centers[i, 1], near_m, rows)):
            j = rows[at]
            if j == i or word[j] != word[i]:
                continue
            dx, dy = centers[i, 0] - centers[j, 0], centers[i, 1] - centers[j, 1]
            if dx * dx + dy * dy < near_m * near_m:
                return min(i, j), max(i, j)
    return -1, -1


@jit
def add_points(points, n_points, cursor, i, surface, n_surface, voxel_m):
    """Add some points of a new view to row `i`, one for each voxel.

    If the row has POINTS points, the oldest are replaced. See `match` for the other arguments.

    - `cursor`: (cap,) int32, position of the next point.
    - `surface`: (k, 3) float32 in `map`; the first `n_surface` rows count.
    - `voxel_m`: side of a voxel.
    """
    step = max(1, n_surface // _POINTS_PER_VIEW)
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


@jit
def add_view(
    index, centers, points, n_points, cursor, reach, i, view_centers, surfaces, n_surface, j,
    views, voxel_m,
):  # fmt: skip
    """Update centre, points, reach and cell of row `i` with box `j` of a new view.

    Return the reach of the row. See `match_near` and `add_points` for the other arguments.

    - `view_centers`: (boxes, 3) float32 in `map`.
    - `surfaces`: (boxes, k, 3) float32 in `map`.
    - `n_surface`: (boxes,) int32, number of surface points of each box that count.
    - `views`: the new view's share of the centre is 1 / views.
    """
    for axis in range(3):
        centers[i, axis] += (view_centers[j, axis] - centers[i, axis]) / np.float32(views)
    add_points(points, n_points, cursor, i, surfaces[j], n_surface[j], voxel_m)
    move(index, i, np.float64(centers[i, 0]), np.float64(centers[i, 1]))
    reach[i] = reach_of(centers, points, n_points, i)
    return np.float64(reach[i])


@jit
def weight_of(x, y, z, points, n_points, T_camera_map, view, depth, near_m, far_m):
    """Return the weight of a view of an object; 0 if its centre is not in view.

    The weight is 1 for an object that is wholly in the image, up to `near_m` away. Beyond, it falls
    with the square of the distance, as does the share of the image that the object fills. From
    `far_m` on it is 0. See `look_kernels.visibility` for the other arguments.
    """
    shown = visibility(x, y, z, points, n_points, T_camera_map, view, depth, far_m)
    if shown == HIDDEN:
        return 0.0
    share = min(1.0, (near_m / ahead_m(T_camera_map, x, y, z)) ** 2)
    return share if shown == WHOLE else PARTIAL * share


@jit
def fuse(
    centers, points, n_points, word, n, now, looked_for, T_camera_map, view, depth, near_m, far_m,
    weight, total, confidence,
):  # fmt: skip
    """Update every row by one image: a detection is evidence for the object, a miss against it.

    See `match` and `weight_of` for the other arguments.

    - `n`: number of rows.
    - `now`: (cap,) float32, score of each row in this image, 0 if it was not detected. All are set
      to 0 at the end.
    - `looked_for`: (words,) bool, True for words that the detector looked for.
    - `weight`: (cap,) float32, sum of weights.
    - `total`: (cap,) float32, sum of weights times scores.
    - `confidence`: (cap,) float32 out.
    """
    for i in range(n):
        if not looked_for[word[i]]:
            now[i] = 0.0
            continue
        x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
        if now[i] <= 0.0 and not 0.0 < ahead_m(T_camera_map, x, y, z) < far_m:
            continue  # most objects of a large map
        w = weight_of(
            x, y, z, points[i], n_points[i], T_camera_map, view, depth, near_m, far_m
        )  # fmt: skip
        if now[i] > 0.0:  # it was detected, even if something hides its centre
            w = max(w, PARTIAL * PARTIAL)
        if w > 0.0:
            weight[i] += w
            total[i] += w * now[i]
            if weight[i] > FORGET:
                weight[i] *= 0.5
                total[i] *= 0.5
            confidence[i] = total[i] / (weight[i] + PRIOR)
        now[i] = 0.0


@jit
def competing_confidence(
    surface, centers, points, n_points, word, confidence, rows, against, within_m
):  # fmt: skip
    """Return the confidence that another object stands at the place of an object.

    Another object counts for the part of the surface that it covers: several chairs may cover all
    of a sofa, a pillow covers little of a bed. An object that lies mostly elsewhere, such as the
    table under a vase, counts little. Objects of one word count together. See `match` for the other
    arguments.

    - `surface`: (k, 3) float32 in `map`, surface points of the object; k > 0.
    - `confidence`: (cap,) float32, confidence of each row.
    - `rows`: (r,) int32, the rows that may cover the object.
    - `against`: (words,) float32, weight of each word's confidence; 0: the word names the same
      object.
    - `within_m`: largest planar distance of a row's centre from the centre of the surface.

    Returns:
        The maximum over words of the mean, over the surface, of the confidence of the word's
        rows that cover it.
    """
    k = len(surface)
    x, y = np.mean(surface[:, 0]), np.mean(surface[:, 1])
    found = np.zeros(len(against), np.bool_)
    cover = np.zeros((len(against), k), np.float32)
    for i in rows:
        dx, dy = centers[i, 0] - x, centers[i, 1] - y
        if against[word[i]] == 0.0 or n_points[i] == 0 or dx * dx + dy * dy > within_m * within_m:
            continue
        is_covered = np.zeros(k, np.bool_)
        inside = 0
        for j in range(n_points[i]):
            is_on_surface = False
            for s in range(k):
                if (
                    abs(points[i, j, 0] - surface[s, 0]) < SAME_M
                    and abs(points[i, j, 1] - surface[s, 1]) < SAME_M
                    and abs(points[i, j, 2] - surface[s, 2]) < SAME_M
                ):
                    is_covered[s] = True
                    is_on_surface = True
            inside += is_on_surface
        # The row counts with `share` of its confidence at each point that it covers.
        share = min(1.0, inside / (WITHIN * n_points[i]))
        found[word[i]] = True
        for s in range(k):
            if is_covered[s]:
                cover[word[i], s] = max(cover[word[i], s], share * confidence[i])
    best = np.float32(0.0)
    for w in range(len(against)):
        if found[w]:
            best = max(best, against[w] * np.mean(cover[w]))
    return best
