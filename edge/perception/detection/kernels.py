"""Image in, boxes out: the arrays around a detector's network. Arrays only, no objects."""

from __future__ import annotations

import numpy as np
from numba import njit

ROUNDING = np.float32(1e-3)
"""How far a score may lie outside 0 to 1 and still be taken for 0 or 1: onnxruntime's own sigmoid
returns up to 1 + 2**-23."""
RIM = 0.01
"""A box that comes this near to the image's edge (share of its side) reaches it."""


@njit(nogil=True, cache=True)
def to_planes(rgb, scale, top, left, out):
    """Write an image into planes: out[c, top + y, left + x] = rgb[y, x, c] * scale.

    Args:
        rgb: (h, w, 3) uint8.
        scale: float32, 1/255 for 0..1.
        top, left: where the image starts in `out`.
        out: (3, H, W) float32; only the image's place is written.
    """
    h, w = rgb.shape[0], rgb.shape[1]
    for y in range(h):
        red, green, blue = out[0, top + y], out[1, top + y], out[2, top + y]
        for x in range(w):
            red[left + x] = rgb[y, x, 0] * scale
            green[left + x] = rgb[y, x, 1] * scale
            blue[left + x] = rgb[y, x, 2] * scale


@njit(nogil=True, cache=True)
def is_sound(boxes, scores, i, far_px):
    """Return whether the box and all scores of anchor `i` are ones that a detector can mean.

    Args:
        boxes: (a, 4) float32.
        scores: (a, n) float32, from `fold`; each must lie in 0 to 1. NaN does not.
        far_px: how far a corner may lie from the origin.
    """
    sound = True
    for k in range(4):
        sound &= abs(boxes[i, k]) <= far_px
    for j in range(scores.shape[1]):
        sound &= 0.0 <= scores[i, j] <= 1.0
    return sound


@njit(nogil=True, cache=True)
def count_unsound(boxes, scores, far_px):
    """Return how many anchors are not sound; see `is_sound`."""
    n = 0
    for i in range(len(boxes)):
        n += not is_sound(boxes, scores, i, far_px)
    return n


@njit(nogil=True, cache=True)
def iou(boxes, i, j):
    """Intersection over union of two rows (x0, y0, x1, y1) of `boxes`; 0 where either is empty.

    By index: a view of a row costs more than all of the arithmetic.
    """
    ax0, ay0, ax1, ay1 = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
    bx0, by0, bx1, by1 = boxes[j, 0], boxes[j, 1], boxes[j, 2], boxes[j, 3]
    w = min(ax1, bx1) - max(ax0, bx0)
    h = min(ay1, by1) - max(ay0, by0)
    if w <= 0.0 or h <= 0.0:
        return 0.0
    inter = w * h
    return inter / ((ax1 - ax0) * (ay1 - ay0) + (bx1 - bx0) * (by1 - by0) - inter)


@njit(nogil=True, cache=True)
def fold(scores, thing, out):
    """The best score of each thing that several columns name; NaN where any of them is.

    What is over 1 by no more than `ROUNDING` becomes 1, what is as little under 0 becomes 0.

    Args:
        scores: (a, columns) float32.
        thing: (columns,) int32, of each column, ascending.
        out: (a, things) float32.
    """
    for i in range(len(scores)):
        last = -1
        for j in range(len(thing)):
            k, s = thing[j], scores[i, j]
            if 1.0 < s <= 1.0 + ROUNDING:
                s = np.float32(1.0)
            elif -ROUNDING <= s < 0.0:
                s = np.float32(0.0)
            if k != last or s > out[i, k] or s != s:
                out[i, k] = s
            last = k


@njit(nogil=True, cache=True)
def candidates(boxes, scores, n_named, tau, far_px, anchor, label, score, top):
    """Everything named at every anchor where it scores at least `tau`, whatever else scores there.

    Args:
        boxes: (a, 4) float32.
        scores: (a, n) float32; columns below `n_named` are targets and context, the rest is none.
        far_px: see `is_sound`.
        anchor, label: (a * n_named,) int32 out, score: (a * n_named,) float32 out.
        top: (a,) float32 out, the best score of any column, 0 where below `tau`.

    Returns:
        (how many candidates were written, how many anchors were left out since they are not
        sound).
    """
    m, invalid = 0, 0
    for i in range(len(boxes)):
        top[i] = 0.0
        if not is_sound(boxes, scores, i, far_px):
            invalid += 1
            continue
        for j in range(scores.shape[1]):
            s = scores[i, j]
            if s < tau:
                continue
            top[i] = max(top[i], s)
            if j < n_named:
                anchor[m], label[m], score[m] = i, j, s
                m += 1
    return m, invalid


@njit(nogil=True, cache=True)
def suppress(boxes, anchor, label, score, m, first, end, one_word, iou_max, keep):
    """Greedy non-maximum suppression among the labels from `first` on, before `end`.

    Args:
        boxes: (a, 4) float32.
        anchor, label, score: from `candidates`, the first `m` count.
        one_word: whether one label alone may have a place; else each may.
        keep: (k,) int32 out, indices of kept candidates, highest score first.

    Returns:
        How many were kept, at most k.
    """
    mine = np.flatnonzero((label[:m] >= first) & (label[:m] < end))
    order = mine[np.argsort(-score[mine], kind="mergesort")]
    n = 0
    for i in order:
        if n == len(keep):
            break
        alone = True
        for k in range(n):
            j = keep[k]
            if (one_word or label[j] == label[i]) and iou(boxes, anchor[i], anchor[j]) > iou_max:
                alone = False
                break
        if alone:
            keep[n] = i
            n += 1
    return n


@njit(nogil=True, cache=True)
def strongest_rivals(
    boxes, scores, competes, tau, top, anchor, label, keep, n, cut, iou_max, out
):  # fmt: skip
    """The best score of any rival on the same place as each kept box (IoU over `iou_max`).

    Args:
        scores: (a, n) float32 as in `candidates`.
        competes: (2, n_targets, n) bool, which columns are rivals of a target that is wholly in
            view, and of one that the image cuts off.
        tau: scores below it do not count.
        top, anchor, label: from `candidates`.
        keep: (k,) int32, the first `n` are indices of candidates.
        cut: (k,) bool, from `to_image`.
        out: (k,) float32.
    """
    scored = np.flatnonzero(top)  # most anchors see nothing
    for k in range(n):
        i, rivals = anchor[keep[k]], competes[1 if cut[k] else 0, label[keep[k]]]
        best = np.float32(0.0)
        for j in scored:
            if top[j] <= best or (j != i and iou(boxes, i, j) <= iou_max):
                continue
            for c in range(scores.shape[1]):
                if rivals[c] and scores[j, c] >= tau and scores[j, c] > best:
                    best = scores[j, c]
        out[k] = best


@njit(nogil=True, cache=True)
def to_image(boxes, anchor, keep, n, scale, top, left, width, height, out, cut):
    """Boxes of the network's input as boxes of the image, clipped to it.

    Args:
        anchor: from `candidates`.
        keep: (m,) int32, the first `n` are indices of candidates; those with an empty box are
            taken out.
        scale: input pixels per image pixel; `top`, `left` the image's place in the input.
        out: (m, 4) float32.
        cut: (m,) bool out, whether the box reaches the image's edge: there may be more of it.

    Returns:
        How many are left; `keep`, `out` and `cut` are compacted alike.
    """
    k = 0
    rim_x, rim_y = RIM * width, RIM * height
    for m in range(n):
        b = boxes[anchor[keep[m]]]
        x0 = min(max((b[0] - left) / scale, 0.0), width)
        y0 = min(max((b[1] - top) / scale, 0.0), height)
        x1 = min(max((b[2] - left) / scale, 0.0), width)
        y1 = min(max((b[3] - top) / scale, 0.0), height)
        if x1 - x0 < 1.0 or y1 - y0 < 1.0:
            continue
        keep[k] = keep[m]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = x0, y0, x1, y1
        cut[k] = x0 < rim_x or y0 < rim_y or x1 > width - rim_x or y1 > height - rim_y
        k += 1
    return k


@njit(nogil=True, cache=True)
def object_boxes(ids, depth, box, pixels, distance):
    """Extent, size and mean distance of every object in an image of object ids.

    Args:
        ids: (h, w) uint16, 0 = none; ids above n are ignored.
        depth: (h, w) float32 metres, NaN or 0 = no return.
        box: (n, 4) int32 out, x0, y0, x1, y1 with x1, y1 one past the end.
        pixels: (n,) int32 out.
        distance: (n,) float32 out, mean depth in metres, 0 where nothing returned.
    """
    h, w = ids.shape
    n = len(pixels)
    returns = np.zeros(n, np.int32)
    for i in range(n):
        box[i, 0], box[i, 1], box[i, 2], box[i, 3] = w, h, 0, 0
        pixels[i] = 0
        distance[i] = 0.0
    for y in range(h):
        for x in range(w):
            i = np.int64(ids[y, x]) - 1
            if i < 0 or i >= n:
                continue
            pixels[i] += 1
            box[i, 0] = min(box[i, 0], x)
            box[i, 1] = min(box[i, 1], y)
            box[i, 2] = max(box[i, 2], x + 1)
            box[i, 3] = max(box[i, 3], y + 1)
            z = depth[y, x]
            if z > 0.0 and np.isfinite(z):
                distance[i] += z
                returns[i] += 1
    for i in range(n):
        if returns[i] > 0:
            distance[i] /= returns[i]
