"""Kernels around a detector's network: image to input, output to boxes. Arrays only.

The network returns one box for each anchor (a place and size in its input), with a score for each
text. The texts are names of classes (`TextClasses`): first the targets, then the context words
(other objects that are reported, too), then classes that only compete. A box is (x0, y0, x1, y1) in
pixels of the input; there are `a` boxes. The last kernel is for simulated detectors.
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit

ROUNDING = np.float32(1e-3)
"""Tolerance of a score outside 0 to 1: onnxruntime's own sigmoid returns up to 1 + 2**-23."""
RIM = 0.01
"""Distance to the image border, as a share of its side, below which a box counts as cut off."""


@jit
def to_planes(rgb, scale, top, left, out):
    """Write an image into planes: out[c, top + y, left + x] = rgb[y, x, c] * scale.

    Args:
        rgb: (h, w, 3) uint8.
        scale: float32, 1/255 for 0..1.
        top: first row of the image in `out`.
        left: first column of the image in `out`.
        out: (3, H, W) float32; only the image's area is written.
    """
    h, w = rgb.shape[0], rgb.shape[1]
    for y in range(h):
        red, green, blue = out[0, top + y], out[1, top + y], out[2, top + y]
        for x in range(w):
            red[left + x] = rgb[y, x, 0] * scale
            green[left + x] = rgb[y, x, 1] * scale
            blue[left + x] = rgb[y, x, 2] * scale


@jit
def is_valid(boxes, scores, i, far_px):
    """Return True if the box and all scores of anchor `i` are valid.

    Args:
        boxes: (a, 4) float32.
        scores: (a, classes) float32, from `best_per_class`; each must be in 0 to 1, so NaN is
            invalid.
        i: index of the anchor.
        far_px: largest distance of a corner from the origin.
    """
    valid = True
    for k in range(4):
        valid &= abs(boxes[i, k]) <= far_px
    for j in range(scores.shape[1]):
        valid &= 0.0 <= scores[i, j] <= 1.0
    return valid


@jit
def count_invalid(boxes, scores, far_px):
    """Return the number of anchors that are not valid; see `is_valid`."""
    n = 0
    for i in range(len(boxes)):
        n += not is_valid(boxes, scores, i, far_px)
    return n


@jit
def iou(boxes, i, j):
    """Return the intersection over union of rows i and j of `boxes`; 0 if either is empty.

    A row is (x0, y0, x1, y1). The arguments are indices, since a view of a row costs more than the
    arithmetic.
    """
    ax0, ay0, ax1, ay1 = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
    bx0, by0, bx1, by1 = boxes[j, 0], boxes[j, 1], boxes[j, 2], boxes[j, 3]
    w = min(ax1, bx1) - max(ax0, bx0)
    h = min(ay1, by1) - max(ay0, by0)
    if w <= 0.0 or h <= 0.0:
        return 0.0
    inter = w * h
    return inter / ((ax1 - ax0) * (ay1 - ay0) + (bx1 - bx0) * (by1 - by0) - inter)


@jit
def best_per_class(scores, class_of_text, out):
    """Write the best score of each class over its texts; NaN if one is NaN.

    A score over 1 by at most `ROUNDING` becomes 1, a score under 0 by at most `ROUNDING` becomes 0.

    Args:
        scores: (a, texts) float32.
        class_of_text: (texts,) int32, index of each text's class, ascending.
        out: (a, classes) float32.
    """
    for i in range(len(scores)):
        last = -1
        for j in range(len(class_of_text)):
            k, s = class_of_text[j], scores[i, j]
            if 1.0 < s <= 1.0 + ROUNDING:
                s = np.float32(1.0)
            elif -ROUNDING <= s < 0.0:
                s = np.float32(0.0)
            # Write the first text's score, a higher one, or NaN (s != s).
            if k != last or s > out[i, k] or s != s:
                out[i, k] = s
            last = k


@jit
def candidates(boxes, scores, n_named, tau, far_px, anchor, label, score, anchor_best):
    """Collect the targets and context words that score at least `tau`, for every anchor.

    A candidate is an anchor with one class; the class's index is its label. One anchor may give
    several candidates; see `suppress`.

    Args:
        boxes: (a, 4) float32.
        scores: (a, classes) float32, from `best_per_class`.
        n_named: number of targets and context words. Classes from there on only compete.
        tau: least score.
        far_px: see `is_valid`.
        anchor: (a * n_named,) int32 out, row of `boxes`.
        label: (a * n_named,) int32 out, column of `scores`.
        score: (a * n_named,) float32 out.
        anchor_best: (a,) float32 out, the best score of any class, 0 if it is below `tau`.

    Returns:
        (number of candidates, number of anchors that were skipped as invalid).
    """
    m, invalid = 0, 0
    for i in range(len(boxes)):
        anchor_best[i] = 0.0
        if not is_valid(boxes, scores, i, far_px):
            invalid += 1
            continue
        for j in range(scores.shape[1]):
            s = scores[i, j]
            if s < tau:
                continue
            anchor_best[i] = max(anchor_best[i], s)
            if j < n_named:
                anchor[m], label[m], score[m] = i, j, s
                m += 1
    return m, invalid


@jit
def suppress(boxes, anchor, label, score, m, first, end, one_word, iou_max, keep):
    """Do greedy non-maximum suppression among the labels in [first, end).

    Args:
        boxes: (a, 4) float32.
        anchor: from `candidates`.
        label: from `candidates`.
        score: from `candidates`.
        m: number of candidates.
        first: first label.
        end: one past the last label.
        one_word: True: boxes of different labels suppress each other, too, so that each place has
            one label.
        iou_max: overlap above which the lower score is suppressed.
        keep: (k,) int32 out, indices of kept candidates, highest score first.

    Returns:
        Number of kept candidates, at most k.
    """
    in_range = np.flatnonzero((label[:m] >= first) & (label[:m] < end))
    order = in_range[np.argsort(-score[in_range], kind="mergesort")]  # highest score first
    n = 0
    for i in order:
        if n == len(keep):
            break
        is_best = True
        for k in range(n):
            j = keep[k]
            if (one_word or label[j] == label[i]) and iou(boxes, anchor[i], anchor[j]) > iou_max:
                is_best = False
                break
        if is_best:
            keep[n] = i
            n += 1
    return n


@jit
def competing_scores(
    boxes, scores, competes, tau, anchor_best, anchor, label, keep, n, cut, iou_max, out
):  # fmt: skip
    """Write the best score of any competing class at the place of each kept box.

    Args:
        boxes: (a, 4) float32.
        scores: (a, classes) float32, as in `candidates`.
        competes: (2, targets, classes) bool, see `TextClasses.competes`.
        tau: lower scores do not count.
        anchor_best: from `candidates`.
        anchor: from `candidates`.
        label: from `candidates`.
        keep: (k,) int32, of which the first `n` are indices of candidates.
        n: number of kept boxes.
        cut: (k,) bool, from `to_image`.
        iou_max: another anchor is at the same place if its IoU is above this.
        out: (k,) float32.
    """
    scored = np.flatnonzero(anchor_best)  # most anchors have no score
    for k in range(n):
        # others: (classes,) bool, the classes that compete with this box's class.
        i, others = anchor[keep[k]], competes[1 if cut[k] else 0, label[keep[k]]]
        best = np.float32(0.0)
        for j in scored:
            # Skip anchors that cannot raise `best`, and those at another place.
            if anchor_best[j] <= best or (j != i and iou(boxes, i, j) <= iou_max):
                continue
            for c in range(scores.shape[1]):
                if others[c] and scores[j, c] >= tau and scores[j, c] > best:
                    best = scores[j, c]
        out[k] = best


@jit
def to_image(boxes, anchor, keep, n, scale, top, left, width, height, out, cut):
    """Map boxes from the network's input to the image, clipped to it; drop empty ones.

    Args:
        boxes: (a, 4) float32, in the network's input.
        anchor: from `candidates`.
        keep: (m,) int32, of which the first `n` are indices of candidates; empty boxes are removed.
        n: number of kept boxes.
        scale: input pixels per image pixel.
        top: first row of the image in the input.
        left: first column of the image in the input.
        width: width of the image in pixels.
        height: height of the image in pixels.
        out: (m, 4) float32.
        cut: (m,) bool out, True if the box reaches the image border, so that the object may
            continue outside the image.

    Returns:
        Number of boxes left; the first entries of `keep`, `out` and `cut` are theirs.
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


@jit
def object_boxes(ids, depth, box, pixels, distance):
    """Write the extent, size and mean distance of every object in an image of object ids.

    Args:
        ids: (h, w) uint16, 0 = none; ids above n are ignored.
        depth: (h, w) float32 metres, NaN or 0 = no return.
        box: (n, 4) int32 out, x0, y0, x1, y1 with x1, y1 one past the end.
        pixels: (n,) int32 out.
        distance: (n,) float32 out, mean depth in metres, 0 if there are no returns.
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
