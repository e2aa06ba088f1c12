"""Recall of the detector in an episode: the share of views of a target that it found."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from edge import names
from edge.geometry import overlaps
from edge.jit import jit
from edge.types import Detections

MIN_VIEW_PX = 150  # fewer visible pixels of an object are no view of it
_MIN_IOU = 0.5


class RecallCounter:
    """Counts views of targets, and how many of them were detected.

    A view is one object in one image. It is detected if a box of its target covers the same pixels:
    IoU of at least 0.5 with the box around what is visible of the object.
    """

    def __init__(self, tau_det: float) -> None:
        self._tau_det = tau_det
        self.views = 0
        self.detected = 0

    def update(
        self, detections: Detections, boxes: np.ndarray, masks: Mapping[str, np.ndarray]
    ) -> None:
        """Add one image, with its `visible_boxes`, and an `object_mask` by target."""
        found = detections.above(self._tau_det)
        labels = [detections.prompts[k] for k in found.class_id.tolist()]
        for target, mask in masks.items():
            own = np.array([names.same_name(label, target) for label in labels], bool)
            seen = boxes[mask]
            seen = seen[seen[:, 4] >= MIN_VIEW_PX, :4]
            self.views += len(seen)
            iou, _ = overlaps(seen, found.xyxy_px[own])
            self.detected += int((iou >= _MIN_IOU).any(axis=1).sum())


@jit
def visible_boxes(ids: np.ndarray, depth_m: np.ndarray, range_m: float, n: int) -> np.ndarray:
    """Return the box around what an image shows of each object, and its number of pixels.

    `ids` is (h, w) uint16, of which 0 and those from n on are ignored. So are pixels farther away
    than `range_m`, or without a depth; `depth_m` is (h, w) float32.

    Returns:
        (n, 5) int64 by id: x0, y0, x1, y1 (one beyond the last pixel), and the count.
    """
    boxes = np.zeros((n, 5), np.int64)
    for v in range(ids.shape[0]):
        for u in range(ids.shape[1]):
            k = ids[v, u]
            if k == 0 or k >= len(boxes) or not depth_m[v, u] <= range_m:
                continue
            if boxes[k, 4] == 0:
                boxes[k, 0], boxes[k, 1] = u, v
            boxes[k, 0] = min(boxes[k, 0], u)
            boxes[k, 2], boxes[k, 3] = max(boxes[k, 2], u + 1), v + 1
            boxes[k, 4] += 1
    return boxes
