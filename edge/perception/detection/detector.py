"""The interface of a detector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from edge.perception.runtime.health import Health
from edge.types import Detections, Observation


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
