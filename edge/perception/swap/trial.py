"""Trial of a new detector on images that the running one has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from edge.config import PerceptionConfig
from edge.errors import UserError
from edge.geometry import overlaps
from edge.perception.detection.detector import Detector
from edge.perception.runtime.health import WHY_INVALID, invalid_boxes_reason
from edge.text import one_line
from edge.types import Detections, Observation

MATCH_IOU = 0.5  # least overlap of a box with the running model's box that it matches
MATCH_SCORE = 0.5  # least score of a matching box, as a share of the running model's score
MIN_RECALL = 0.5  # least share of the running model's boxes that a related model must find
_WARM_UPS = 2  # runs before the measurement
_ROUNDS = 3  # measured runs of each image

_FORCE = "add --force to use it anyway"


class UnfitModelError(UserError):
    """The reason why a model may not replace another; one line."""


@dataclass(frozen=True, slots=True)
class TrialImage:
    """A copy of an image with the running model's detections.

    Attributes:
        observation: holds the copy of the image.
        found: the detections in the image; None if the running model failed.
    """

    observation: Observation
    found: Detections | None


def sample(observation: Observation, outcome: Detections | Exception) -> TrialImage:
    """Copy an image with its detections; nothing else of the observation is kept."""
    rgb = observation.rgb.copy()
    copy = replace(observation, rgb=rgb, depth_m=None, cloud_m=None, slot=None)
    failed = isinstance(outcome, Exception)
    return TrialImage(copy, None if failed else replace(outcome, observation=copy))


def run_trial(
    detector: Detector,
    samples: Sequence[TrialImage],
    perception: PerceptionConfig,
    running: str,
    related: bool,
    force: bool = False,
) -> str:
    """Run the model on the samples, after some warm-up runs, and judge it.

    The running model shares the machine at that time, so the shortest of a few runs counts for each
    image. The probation measures the model alone.

    Args:
        detector: the new model.
        samples: images of the trial, at least one.
        perception: time budget and score threshold.
        running: name of the running model, whose boxes the samples hold.
        related: True if both are of one family, so that the boxes must be found again.
        force: True: a slow model, or one with other boxes, is reported but not rejected.

    Returns:
        The result, in one line.

    Raises:
        UnfitModelError: the model fails, returns invalid boxes, is too slow, or finds too few of
            the boxes.
    """
    for _ in range(_WARM_UPS):
        run(detector, samples[0].observation)
    # Detections by round and image; for each image, the shortest time of its rounds counts.
    runs = [[run(detector, s.observation) for s in samples] for _ in range(_ROUNDS)]
    took_ms = median_ms([min(f.latency_ns for f in same) for same in zip(*runs, strict=True)])
    pace = f"median {took_ms:.1f} ms on {len(samples)} images"
    budget_ms = perception.swap.budget_ms
    if took_ms > budget_ms and not force:
        raise UnfitModelError(
            f"too slow: {pace}, perception.swap.budget_ms is {budget_ms:g}; {_FORCE}"
        )
    n_old, n_found = boxes_found_again(samples, runs[0], perception.tau_det)
    if n_old == 0:
        return f"{pace}; {running} found nothing on these images to compare with"
    share = f"finds {n_found} of the {n_old} boxes of {running}"
    if not related:
        return f"{pace}; {share} (another family: no reason to refuse it)"
    if n_found < MIN_RECALL * n_old and not force:
        raise UnfitModelError(f"{share}, fewer than half; {_FORCE}")
    return f"{pace}; {share}"


def run(detector: Detector, observation: Observation) -> Detections:
    """Detect in one image; raise UnfitModelError if that fails or a box is invalid."""
    before = detector.invalid_boxes
    try:
        found = detector.detect(observation)
    except Exception as error:  # a model may raise anything
        raise UnfitModelError(failure(error)) from None
    if fault := invalid_output_reason(detector, before, found):
        raise UnfitModelError(fault)
    return found


def failure(error: Exception) -> str:
    """Return the error of a model as a reason in one line."""
    return f"it fails: {type(error).__name__}: {one_line(error, 300)}"


def invalid_output_reason(detector: Detector, before: int, found: Detections) -> str:
    """Return the reason to reject invalid boxes or scores; "" if all are valid."""
    if (invalid := detector.invalid_boxes - before) > 0:
        return f"it returns {invalid} boxes of an image that are {WHY_INVALID}"
    faults = [invalid_boxes_reason(found.xyxy_px, found.score, found.competing_score)]
    if found.context is not None:
        faults.append(invalid_boxes_reason(found.context.xyxy_px, found.context.score))
    return next((f"it returns {fault}" for fault in faults if fault), "")


def median_ms(times_ns: Sequence[int]) -> float:
    return median(times_ns) * 1e-6


def boxes_found_again(
    samples: Sequence[TrialImage], runs: Sequence[Detections], tau: float
) -> tuple[int, int]:
    """Count the boxes of the running model, and those that the new model finds again.

    Only boxes with a score of at least `tau` that are not suppressed count. A box is found again if
    the new model has a box with the same prompt, an IoU of at least `MATCH_IOU`, and at least
    `MATCH_SCORE` times the old score. Samples with other prompts than the runs do not count.

    Returns:
        (boxes of the running model, those found again).
    """
    n_old = n_found = 0
    for image, new in zip(samples, runs, strict=True):
        reference = image.found
        if reference is None or reference.prompts != new.prompts:
            continue
        for i in np.flatnonzero(reference.not_suppressed() & (reference.score >= tau)):
            similar = new.class_id == reference.class_id[i]
            similar &= new.score >= MATCH_SCORE * reference.score[i]
            iou, _ = overlaps(reference.xyxy_px[i : i + 1], new.xyxy_px[similar])
            n_found += bool((iou >= MATCH_IOU).any())
            n_old += 1
    return n_old, n_found
