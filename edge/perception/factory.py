"""Which detectors there are, and the one that a configuration names."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from edge import config
from edge.perception.detector import Detector, Tell, log_progress
from edge.perception.sim_detector import SimDetector, TruthAt


def _onnx(
    detector: config.DetectorOnnx, prompts: Sequence[str], progress: Tell, truth: TruthAt | None
) -> Detector:
    from edge.perception.onnx_detector import OnnxDetector

    return OnnxDetector(detector, prompts, progress)


def _sim(
    detector: config.DetectorSim, prompts: Sequence[str], progress: Tell, truth: TruthAt | None
) -> Detector:
    return SimDetector(detector, prompts, truth)


REGISTRY = {"onnx": _onnx, "sim": _sim}


def make_detector(
    perception: config.Perception,
    prompts: Sequence[str],
    progress: Tell = log_progress,
    *,
    cancelled: threading.Event | None = None,
    truth: TruthAt | None = None,
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
