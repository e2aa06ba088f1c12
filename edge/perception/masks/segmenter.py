"""Interface of a segmenter, and code that segmenters share."""

from __future__ import annotations

import math
from time import perf_counter
from typing import Protocol

import cv2
import numpy as np

from edge.types import MASK_SIDE

# Middles of a mask's rows or columns, as shares of the box's side.
_MIDDLES = (np.arange(MASK_SIDE, dtype=np.float32) + 0.5) / MASK_SIDE


class Deadline:
    """The time at which work on an image must end.

    Args:
        seconds: time from now; None: no limit.
    """

    def __init__(self, seconds: float | None) -> None:
        self._end_s = math.inf if seconds is None else perf_counter() + seconds

    def left_s(self) -> float:
        """Return the seconds left: 0 or less once the deadline has passed, inf without one."""
        return self._end_s - perf_counter()


class Segmenter(Protocol):
    """Separates the object in a box from what is in front of and behind it.

    Attributes:
        name: the model's card, or a description if there is no model.
    """

    name: str

    def segment(
        self, rgb: np.ndarray, boxes: np.ndarray, out: np.ndarray, deadline: Deadline
    ) -> int:
        """Make masks of the boxes, in order, until the deadline.

        Args:
            rgb: (h, w, 3) uint8, contiguous.
            boxes: (n, 4) float32 xyxy in pixels, finite and not empty.
            out: (n, MASK_SIDE, MASK_SIDE) bool, filled; see `Detections.mask`. All False on entry.
            deadline: when to stop.

        Returns:
            Number of boxes processed in time.
        """
        ...

    def close(self) -> None: ...


def rasterise(
    values: np.ndarray,
    origin_px: tuple[float, float],
    scale: tuple[float, float],
    box: np.ndarray,
    out: np.ndarray,
) -> None:
    """Sample an image that is positive on the object into a mask over its box.

    Args:
        values: (rows, columns) float32, positive on the object.
        origin_px: x and y of the corner of `values` in the camera's image.
        scale: columns and rows of `values` per pixel of the camera's image.
        box: (4,) xyxy in pixels of the camera's image.
        out: (MASK_SIDE, MASK_SIDE) bool.
    """
    # Columns and rows of `values` at the middles of the mask's cells; k is 0 for x and 1 for y.
    x, y = (
        (box[k] + _MIDDLES * (box[k + 2] - box[k]) - origin_px[k]) * scale[k] - 0.5 for k in (0, 1)
    )
    columns, rows = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    sampled = cv2.remap(
        values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0
    )
    np.greater(sampled, 0.0, out=out)
