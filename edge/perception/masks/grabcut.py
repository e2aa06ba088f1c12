"""Masks by colour alone with OpenCV's GrabCut (Rother, Kolmogorov, Blake, SIGGRAPH 2004)."""

from __future__ import annotations

import cv2
import numpy as np

from edge.perception.masks.segmenter import Deadline, rasterise
from edge.types import MASK_SIDE

SIDE_PX = 64
"""The window around a box is scaled down until its longer side has this many pixels."""
MARGIN = 0.25
"""Margin of the window on each side of the box, as a share of the box's width and height."""
ITERATIONS = 1
"""Iterations of GrabCut."""
SPAN = 0.7
"""Least share of its box's width and height that a mask must span.

A smaller mask is of another object in the box and is dropped: a box is fitted to its object."""
LEAST_PX = 4
"""Least side of a box in the scaled window, in pixels; a smaller box gets no mask."""


class GrabcutSegmenter:
    """A segmenter (`Segmenter`) that models the colours around a box as background.

    GrabCut fits one colour model to the margin and another to the inside, then cuts along edges in
    the image. Depth did not help: not as a channel, not as a seed of the background, not as a vote
    on the result. More than one iteration did not help either (measured, docs/models.md).
    """

    name = "grabcut (colour alone, no neural network)"

    def segment(
        self, rgb: np.ndarray, boxes: np.ndarray, out: np.ndarray, deadline: Deadline
    ) -> int:
        """See `Segmenter.segment`."""
        for i, box in enumerate(boxes):
            if deadline.left_s() <= 0.0:
                return i
            _cut(rgb, box, out[i])
        return len(boxes)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def _cut(rgb: np.ndarray, box: np.ndarray, out: np.ndarray) -> None:
    """Write the mask of one box into `out`.

    The mask stays empty if no background is visible around the box, the box is too small, or the
    result spans too little of the box.
    """
    height, width = rgb.shape[:2]
    margin_u, margin_v = MARGIN * (box[2] - box[0]), MARGIN * (box[3] - box[1])
    left, top = max(0, int(box[0] - margin_u)), max(0, int(box[1] - margin_v))
    right, bottom = min(width, int(box[2] + margin_u) + 1), min(height, int(box[3] + margin_v) + 1)
    if right <= left or bottom <= top:
        return
    shrink = min(1.0, SIDE_PX / max(right - left, bottom - top))
    columns = max(1, round((right - left) * shrink))
    rows = max(1, round((bottom - top) * shrink))
    window = cv2.resize(rgb[top:bottom, left:right], (columns, rows), interpolation=cv2.INTER_AREA)
    # The box in the window, and GrabCut's labels: background, or perhaps foreground.
    scale = columns / (right - left), rows / (bottom - top)
    u0, u1 = (round((u - left) * scale[0]) for u in (box[0], box[2]))
    v0, v1 = (round((v - top) * scale[1]) for v in (box[1], box[3]))
    labels = np.full((rows, columns), cv2.GC_BGD, np.uint8)
    labels[max(0, v0) : v1, max(0, u0) : u1] = cv2.GC_PR_FGD
    inside = min(v1, rows) - max(0, v0), min(u1, columns) - max(0, u0)
    if min(inside) < LEAST_PX or (labels == cv2.GC_BGD).sum() < LEAST_PX:
        return
    cv2.setRNGSeed(0)  # of this thread, for k-means: a run must replay the same
    models = np.zeros((1, 65)), np.zeros((1, 65))  # scratch of GrabCut, in OpenCV's size
    cv2.grabCut(window, labels, None, *models, ITERATIONS, cv2.GC_INIT_WITH_MASK)
    foreground = (labels & 1).astype(np.float32) - 0.5  # GC_FGD is 1, GC_PR_FGD is 3
    rasterise(foreground, (left, top), scale, box, out)
    for axis in range(2):
        covered = np.flatnonzero(out.any(axis=axis))
        if len(covered) == 0 or covered[-1] - covered[0] + 1 < SPAN * MASK_SIDE:
            out[:] = False
            return
