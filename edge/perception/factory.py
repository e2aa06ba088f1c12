"""Registry of detectors, and the detector that a configuration names."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

from edge import config
from edge.perception.detection.detector import Detector
from edge.perception.detection.sim import SimDetector, TruthAt
from edge.perception.runtime.cards import ModelError, load_detector_card
from edge.perception.runtime.fallback import LONGEST_WAIT_S
from edge.perception.runtime.health import ProgressCallback, log_progress

if TYPE_CHECKING:  # load only the backend in use
    from edge.perception.detection.fallback import FallbackDetector
    from edge.perception.detection.onnx import OnnxDetector
    from edge.perception.detection.remote import RemoteDetector


def open_detector(
    detector: config.DetectorOnnx, prompts: Sequence[str], progress: ProgressCallback = log_progress
) -> OnnxDetector | RemoteDetector:
    """Open the detector of a card, on this computer or on the card's server.

    Raises:
        PromptError, ModelError: see `OnnxDetector` and `RemoteDetector`.
    """
    card = load_detector_card(detector.model)
    if card.server is not None:
        from edge.perception.detection.remote import RemoteDetector

        if detector.fallback is not None:
            limit_s = min(card.server.time_limit_s, LONGEST_WAIT_S)
            server = card.server.model_copy(update={"time_limit_s": limit_s})
            card = card.model_copy(update={"server": server})
        return RemoteDetector(detector, card, prompts, progress)
    from edge.perception.detection.onnx import OnnxDetector

    return OnnxDetector(detector, prompts, progress)


def _runs_on_server(detector: config.DetectorOnnx | config.DetectorSim) -> bool:
    """Return True if a server runs the model; such a model needs no process on this computer."""
    try:
        return detector.kind == "onnx" and load_detector_card(detector.model).server is not None
    except ModelError:  # the caller that loads the card reports it
        return False


def make_detector(
    perception: config.PerceptionConfig,
    prompts: Sequence[str],
    progress: ProgressCallback = log_progress,
    *,
    cancelled: threading.Event | None = None,
    truth: TruthAt | None = None,
) -> Detector:
    """Make the detector that the configuration names, ready to use.

    Args:
        perception: the configuration.
        prompts: names of the objects to look for.
        progress: called every few seconds while a TensorRT engine is built, which takes minutes.
        cancelled: once set, a model process that is not ready yet is ended, which raises
            ModelError. Without process isolation the model is loaded to the end.
        truth: ground truth for `kind: sim`.

    Raises:
        PromptError: see `Detector.set_prompts`.
        ModelError: the model cannot be loaded, or not with the configured providers.

    Example:
        >>> from edge.config import DetectorSim, PerceptionConfig
        >>> detector = make_detector(PerceptionConfig(detector=DetectorSim()), ["chair"])
        >>> detector.prompts
        ('chair',)
    """
    on_server = _runs_on_server(perception.detector)
    if on_server and perception.detector.fallback is not None:
        return _make_with_fallback(perception, prompts, progress, cancelled)
    if perception.isolation == "process" and not on_server:
        from edge.perception.detection.process import ProcessDetector

        return ProcessDetector(perception, prompts, progress, cancelled)
    if perception.detector.kind == "sim":
        return SimDetector(perception.detector, prompts, truth)
    return open_detector(perception.detector, prompts, progress)


def _make_with_fallback(
    perception: config.PerceptionConfig,
    prompts: Sequence[str],
    progress: ProgressCallback,
    cancelled: threading.Event | None,
) -> FallbackDetector:
    """Make the detector on a server, and the one on this computer for when the server fails."""
    from edge.perception.detection.fallback import FallbackDetector

    detector = perception.detector
    local = detector.model_copy(update={"model": detector.fallback, "fallback": None})
    try:
        if _runs_on_server(local):
            raise ModelError(f"model {local.model} runs on a server; name one of this computer")
        made = make_detector(
            perception.model_copy(update={"detector": local}), prompts, progress,
            cancelled=cancelled,
        )  # fmt: skip
    except ModelError as error:
        raise ModelError(f"perception.detector.fallback: {error}") from None
    try:
        return FallbackDetector(open_detector(detector, prompts, progress), made)
    except Exception:
        made.close()
        raise
