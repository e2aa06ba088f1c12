"""Adds masks to detections, by the segmenter that the configuration names.

A mask says which pixels of a box show the object; back-projection then ignores the others.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from time import perf_counter_ns
from typing import Union

import numpy as np

from edge import config
from edge.errors import UserError
from edge.perception.detection.detector import check_rgb
from edge.perception.masks.segmenter import Deadline, Segmenter
from edge.text import one_line
from edge.types import MASK_SIDE, Detections

log = logging.getLogger(__name__)

Settings = Union[config.SegmenterGrabcut, config.SegmenterOnnx]
_LONGEST_ERROR = 300  # characters


class Masker:
    """Adds masks to the targets' boxes with the highest scores; runs on the detector's thread.

    If the segmenter fails, detections go on without masks: a slightly wrong position is better than
    none.

    Attributes:
        n_masks: number of boxes with a mask.
        n_skipped: number of boxes skipped for lack of time.
        failed: number of images for which the segmenter failed.
        last_error: the newest error, one line; empty if there was none.
    """

    def __init__(self, segmenter: Segmenter, settings: Settings, timed: bool = True) -> None:
        self.n_masks = self.n_skipped = self.failed = 0
        self.last_error = ""
        self._segmenter, self._most = segmenter, settings.max_boxes
        self._limit_s = settings.time_limit_s if timed else None

    def add(self, found: Detections) -> Detections:
        """Return the same detections with `Detections.mask`."""
        start_ns, n = perf_counter_ns(), len(found)
        masks = np.zeros((n, MASK_SIDE, MASK_SIDE), np.bool_)
        boxes = np.asarray(found.xyxy_px[: self._most], np.float32)
        valid = np.isfinite(boxes).all(axis=1) & (boxes[:, 2:] > boxes[:, :2]).all(axis=1)
        rows = np.flatnonzero(valid)
        if len(rows):
            try:
                drawn = np.zeros((len(rows), MASK_SIDE, MASK_SIDE), np.bool_)
                rgb = check_rgb(found.observation)
                done = self._segmenter.segment(rgb, boxes[rows], drawn, Deadline(self._limit_s))
                masks[rows] = drawn
                self.n_skipped += len(rows) - done
                self.n_masks += int(drawn.any(axis=(1, 2)).sum())
            except Exception as error:  # keep the detections
                self._record_failure(error)
        took_ns = perf_counter_ns() - start_ns
        return replace(found, mask=masks, latency_ns=found.latency_ns + took_ns)

    def status(self) -> dict[str, object]:
        """Return counts for the status message, JSON-ready."""
        return {
            "model": self._segmenter.name, "made": self.n_masks, "late": self.n_skipped,
            "failed": self.failed, "last_error": self.last_error,
        }  # fmt: skip

    def close(self) -> None:
        """Release the segmenter."""
        self._segmenter.close()

    def _record_failure(self, error: Exception) -> None:
        """Count a failure of the segmenter; log the first."""
        text = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        self.failed, self.last_error = self.failed + 1, one_line(text, _LONGEST_ERROR)
        if self.failed == 1:
            log.error("segmenter %s: %s; boxes are used without masks (further errors are "
                      "only counted)", self._segmenter.name, self.last_error)  # fmt: skip


def make_segmenter(settings: Settings) -> Segmenter:
    """Make the segmenter that the configuration names, ready to use.

    Raises:
        ModelError: its model cannot be loaded, or not with the configured providers.
    """
    if isinstance(settings, config.SegmenterGrabcut):
        from edge.perception.masks.grabcut import GrabcutSegmenter

        return GrabcutSegmenter()
    from edge.perception.masks.sam import SamSegmenter

    return SamSegmenter(settings)


def make_masker(perception: config.PerceptionConfig, timed: bool = True) -> Masker | None:
    """Make the masker that the configuration asks for; None: no masks.

    Raises:
        ModelError: see `make_segmenter`.
    """
    settings = perception.segmenter
    if isinstance(settings, config.SegmenterNone):
        return None
    return Masker(make_segmenter(settings), settings, timed)
