"""The interface of a detector: boxes of the objects that prompts name, in an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from edge.perception.runtime.health import ModelHealth
from edge.types import Detections, Observation


class Detector(Protocol):
    """Detects the objects that the prompts name in the images of observations.

    Attributes:
        name: the model's card, or a description if there is no model.
        prompts: names of the objects to look for; `Detections.class_id` is an index into them.
        invalid_boxes: number of boxes since the start that were dropped as invalid
            (`health.WHY_INVALID`).
        looks_at: name of the observation's attribute that the detector needs; observations without
            it are skipped. A detector need not have `looks_at`; the default is `rgb`.
    """

    name: str
    prompts: tuple[str, ...]
    invalid_boxes: int

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """Use other prompts from the next image on; may be called from another thread.

        Raises:
            PromptError: a prompt is empty or cannot be turned into an embedding.
            ModelError: there is no memory for the prompts, or the model fails; the old ones stay.
        """
        ...

    def detect(self, observation: Observation) -> Detections:
        """Return every box with a score of `tau_vl` or more, highest score first.

        Raises:
            ValueError: the observation's image is missing, empty or not (h, w, 3) uint8.
        """
        ...

    def health(self) -> ModelHealth:
        """Return the health now; may be called from another thread, never blocks."""
        ...

    def close(self) -> None: ...


def check_rgb(observation: Observation) -> np.ndarray:
    """Return the observation's image, contiguous; raise ValueError if it is unusable."""
    rgb = observation.rgb
    if rgb is None:
        raise ValueError(
            f"observation {observation.seq}: it has no camera image to detect objects in"
        )
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise ValueError(
            f"observation {observation.seq}: image is {rgb.dtype} {rgb.shape}, "
            "must be uint8 (height, width, 3) and not empty"
        )
    return np.ascontiguousarray(rgb)
