"""What a segmenter is, and what segmenters share; nothing here knows which there are."""

from __future__ import annotations

import math
from time import perf_counter
from typing import Protocol

import cv2
import numpy as np

from edge.types import MASK_SIDE

_MIDDLES = (np.arange(MASK_SIDE, dtype=np.float32) + 0.5) / MASK_SIDE


class Deadline:
    """When work on an image has to be over.

    Args:
        seconds: from now; None: never.
    """

    def __init__(self, seconds: float | None) -> None:
        self._end_s = math.inf if seconds is None else perf_counter() + seconds

    def left_s(self) -> float:
        """Seconds until then; not positive once it has passed, infinite where there is none."""
        return self._end_s - perf_counter()


class Segmenter(Protocol):
    """Tells the thing in a box from what is before and behind it.

    Attributes:
        name: the model's card, or what it is when it is no model.
    """

    name: str

    def segment(
        self, rgb: np.ndarray, boxes: np.ndarray, out: np.ndarray, deadline: Deadline
    ) -> int:
        """Make masks of the boxes, from the first on, until the deadline.

        Args:
            rgb: (h, w, 3) uint8, contiguous.
            boxes: (n, 4) float32 xyxy in pixels, finite and not empty.
            out: (n, MASK_SIDE, MASK_SIDE) bool, filled; see `Detections.mask`. All False on entry.

        Returns:
            How many boxes there was time for.
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
    """A mask over its box, of an image of values that are positive where the thing is.

    Args:
        values: (rows, columns) float32.
        origin_px: x and y in the camera's image of the corner of `values`.
        scale: columns and rows of `values` to a pixel of the camera's image.
        box: (4,) xyxy in pixels of the camera's image.
        out: (MASK_SIDE, MASK_SIDE) bool.
    """
    x, y = (
        (box[k] + _MIDDLES * (box[k + 2] - box[k]) - origin_px[k]) * scale[k] - 0.5 for k in (0, 1)
    )
    columns, rows = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    sampled = cv2.remap(
        values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0
    )
    np.greater(sampled, 0.0, out=out)
