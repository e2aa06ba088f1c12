"""The health of a model, and checks of its output."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import numpy as np

log = logging.getLogger(__name__)

ModelStateName = Literal["ok", "building engine", "restarting", "degraded"]
MODEL_STATES: tuple[ModelStateName, ...] = get_args(ModelStateName)


class ModelHealth(NamedTuple):
    """The health of a detector.

    Attributes:
        state: `ok`; `building engine` (TensorRT, takes minutes); `restarting` (its process ended);
            `degraded` (its process ended too often, its server gives no answers, or it fails at
            every image: nothing is detected).
        detail: one line for a person, empty if there is nothing to report.
    """

    state: ModelStateName = "ok"
    detail: str = ""


WHY_INVALID = "not finite, far outside the image, or scored outside 0 to 1"
"""Reason why boxes are invalid and dropped, for every message about them."""

ProgressCallback = Callable[[ModelHealth], None]
"""Called every few seconds, on any thread, with the health of a detector that is loading."""


def log_progress(health: ModelHealth) -> None:
    """Log the health; the default `ProgressCallback`."""
    log.info("%s: %s", health.state, health.detail)


# Parts of messages by which onnxruntime and CUDA report a lack of memory.
_NO_MEMORY = ("allocate memory", "bad_alloc", "bad allocation", "out of memory")


def is_out_of_memory(error: Exception) -> bool:
    """Return True if an error of Python, onnxruntime or CUDA reports a lack of memory."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(sign in text for sign in _NO_MEMORY)


def invalid_boxes_reason(
    xyxy_px: np.ndarray, score: np.ndarray, competing_score: np.ndarray | None = None
) -> str:
    """Return the fault of a detector's boxes and scores; "" if there is none.

    Args:
        xyxy_px: (n, 4) boxes.
        score: (n,) scores.
        competing_score: (n,) scores of competing classes, or None.
    """
    if not np.isfinite(xyxy_px).all():
        return "boxes that are not finite"
    for scores in (score, *(() if competing_score is None else (competing_score,))):
        if not ((scores >= 0) & (scores <= 1)).all():  # NaN is neither
            return "scores that are not in 0 to 1"
    return ""
