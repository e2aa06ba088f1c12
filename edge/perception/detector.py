"""What a detector is, and the registry of those there are."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np

from edge import config
from edge.types import Detections, Observation

if TYPE_CHECKING:
    from edge.perception.sim_detector import Truth

log = logging.getLogger(__name__)


class Health(NamedTuple):
    """How a detector is.

    Attributes:
        state: `ok`; `building engine` (TensorRT, takes minutes); `restarting` (its process ended);
            `degraded` (it ended too often, or fails at every image: nothing is detected).
        detail: one line for a person, empty when there is nothing to say.
    """

    state: Literal["ok", "building engine", "restarting", "degraded"] = "ok"
    detail: str = ""


Progress = Callable[[Health], None]
"""Told every few seconds how a detector is that is still being made; from any thread."""


class Detector(Protocol):
    """Finds what the prompts name in the images of observations.

    Attributes:
        name: the model's card, or what it is when it is no model.
        prompts: what is looked for, `Detections.class_id` counts in them.
        invalid_boxes: boxes of the model that were not finite, since the start; dropped.
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


def _onnx(
    detector: config.DetectorOnnx, prompts: Sequence[str], progress: Progress, truth: Truth | None
) -> Detector:
    from edge.perception.onnx_detector import OnnxDetector

    return OnnxDetector(detector, prompts, progress)


def _sim(
    detector: config.DetectorSim, prompts: Sequence[str], progress: Progress, truth: Truth | None
) -> Detector:
    from edge.perception.sim_detector import SimDetector

    return SimDetector(detector, prompts, truth)


REGISTRY = {"onnx": _onnx, "sim": _sim}


def make_detector(
    perception: config.Perception,
    prompts: Sequence[str],
    progress: Progress = log_progress,
    *,
    cancelled: threading.Event | None = None,
    truth: Truth | None = None,
) -> Detector:
    """The detector that the configuration names, ready to use.

    Args:
        progress: told every few seconds while a TensorRT engine is built, which takes minutes.
        cancelled: once set, a model's process that is not ready yet is ended, which is a
            ModelError; without isolation the model is loaded to its end.
        truth: what `kind: sim` takes for seen.

    Raises:
        PromptError: see `Detector.set_prompts`.
        ModelError: the model cannot be loaded, or not with the providers asked for.
    """
    if perception.isolation == "process":
        from edge.perception.process.detector import ProcessDetector

        return ProcessDetector(perception, prompts, progress, cancelled)
    return REGISTRY[perception.detector.kind](perception.detector, prompts, progress, truth)


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
