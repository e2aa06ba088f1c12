"""What a detector is, and how it says how it is; nothing here knows which there are."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol, get_args

import numpy as np

from edge.types import Detections, Observation

log = logging.getLogger(__name__)


HealthState = Literal["ok", "building engine", "restarting", "degraded"]
HEALTH_STATES: tuple[HealthState, ...] = get_args(HealthState)


class Health(NamedTuple):
    """How a detector is.

    Attributes:
        state: `ok`; `building engine` (TensorRT, takes minutes); `restarting` (its process ended);
            `degraded` (it ended too often, or fails at every image: nothing is detected).
        detail: one line for a person, empty when there is nothing to say.
    """

    state: HealthState = "ok"
    detail: str = ""


UNSOUND = "not finite, far outside the image, or scored outside 0 to 1"
"""The boxes of a model that are dropped, in the words of every message about them."""

Tell = Callable[[Health], None]
"""Told every few seconds how a detector is that is still being made; from any thread."""


class Detector(Protocol):
    """Finds what the prompts name in the images of observations.

    Attributes:
        name: the model's card, or what it is when it is no model.
        prompts: what is looked for, `Detections.class_id` counts in them.
        invalid_boxes: boxes of the model that were not sound, since the start; dropped.
        looks_at: the array of an observation that it needs; optional, `rgb` by default.
    """

    name: str
    prompts: tuple[str, ...]
    invalid_boxes: int

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """Look for something else from the next image on; may be called from another thread.

        Raises:
            PromptError: a prompt is empty or cannot be turned into an embedding.
            ModelError: there is no memory for them, or the model fails; the prompts are those of
                before.
        """
        ...

    def detect(self, observation: Observation) -> Detections:
        """Everything above `tau_vl`, highest score first.

        Raises:
            ValueError: the observation's image is missing, empty or not (h, w, 3) uint8.
        """
        ...

    def health(self) -> Health:
        """How it is now; may be called from another thread, never blocks."""
        ...

    def close(self) -> None: ...


def log_progress(health: Health) -> None:
    """A line in the log."""
    log.info("%s: %s", health.state, health.detail)


def fault_of(xyxy_px: np.ndarray, score: np.ndarray, rival: np.ndarray | None = None) -> str:
    """Return what is wrong with boxes and scores that a detector returned; empty: nothing."""
    if not np.isfinite(xyxy_px).all():
        return "boxes that are not finite"
    for scores in (score, *(() if rival is None else (rival,))):
        if not ((scores >= 0) & (scores <= 1)).all():  # NaN is neither
            return "scores that are not in 0 to 1"
    return ""


def check_rgb(observation: Observation) -> np.ndarray:
    """The observation's image, contiguous; raises ValueError if it is unusable."""
    rgb = observation.rgb
    if rgb is None:
        raise ValueError(f"observation {observation.seq}: no image to detect in")
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise ValueError(
            f"observation {observation.seq}: image is {rgb.dtype} {rgb.shape}, "
            "must be uint8 (height, width, 3) and not empty"
        )
    return np.ascontiguousarray(rgb)
