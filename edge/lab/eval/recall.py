"""Recall of the detector in an episode: the share of views of a target that it found."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from edge import names
from edge.jit import jit
from edge.types import Detections

MIN_VIEW_PX = 150  # fewer visible pixels of an object are no view of it
_MIN_IOU = 0.5


class RecallCounter:
    """Counts views of targets, and how many of them were detected.

    A view is one object in one image. It is detected if a box of its target covers the same pixels:
    IoU of at least 0.5 with the box around what is visible of the object.

    Args:
        tau_det: least score of a detection that becomes an instance.
        range_m: pixels that are farther away do not count.
    """

    def __init__(self, tau_det: float, range_m: float) -> None:
        self._tau_det, self._range_m = tau_det, range_m
        self.views = 0
        self.detected = 0
        # Compile now, not in a timed tick.
        empty = np.zeros((1, 1), np.uint16), np.zeros((1, 1), np.float32)
        visible_boxes(*empty, range_m, np.zeros((1, 5), np.int64))

    def update(
        self,
        detections: Detections,
        ids: np.ndarray,
        depth_m: np.ndarray,
        masks: Mapping[str, np.ndarray],
    ) -> None:
        """Add one image.

        Args:
            detections: of the image.
            ids: (h, w) uint16 object ids of the image.
            depth_m: (h, w) float32.
            masks: by target, see `edge.lab.eval.ground_truth.object_mask`.
        """
        if not masks:
            return
        boxes = np.zeros((max(map(len, masks.values())), 5), np.int64)
        visible_boxes(ids, depth_m, self._range_m, boxes)
        found = detections.above(self._tau_det)
        labels = [detections.prompts[k] for k in found.class_id.tolist()]
        for target, mask in masks.items():
            own = np.array([names.same_name(label, target) for label in labels], bool)
            seen = boxes[: len(mask)][mask]
            seen = seen[seen[:, 4] >= MIN_VIEW_PX, :4].astype(float)
            self.views += len(seen)
            self.detected += int((iou(seen, found.xyxy_px[own]) >= _MIN_IOU).any(axis=1).sum())


def iou(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return (n, m) intersections over unions of (n, 4) and (m, 4) boxes x0, y0, x1, y1."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=2)
    area, other_area = (np.prod(b[:, 2:] - b[:, :2], axis=1) for b in (boxes, others))
    return shared / np.maximum(area[:, None] + other_area[None] - shared, 1e-9)


@jit
def visible_boxes(ids: np.ndarray, depth_m: np.ndarray, range_m: float, boxes: np.ndarray) -> None:
    """Fill `boxes` (n, 5) int64 by object id: first and last pixel (x0, y0, x1, y1), and count.

    Args:
        ids: (h, w) uint16 object ids; those from n on are ignored.
        depth_m: (h, w) float32, NaN = no return.
        range_m: farther pixels are ignored.
        boxes: zeros; x1 and y1 are one beyond the last pixel.
    """
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
