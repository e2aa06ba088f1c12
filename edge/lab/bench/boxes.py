"""Comparison of detected boxes with the ground truth, and with another model's boxes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from edge.geometry import overlaps

MATCH_IOU = 0.5
"""Boxes match if their intersection over union is at least this."""
COVERED = 0.5
"""A box that hits nothing is ignored, not counted as false, if this share of it is in an object
that does not count, or that is only a kind of the prompt."""
UNRELATED, KIND_OF_PROMPT, SAME_NAME = 0, 1, 2
"""Relation of an object's label to a prompt. An armchair is a kind of the prompt "chair"."""


@dataclass(frozen=True, slots=True)
class DetectedBoxes:
    """Boxes of one image, highest score first.

    Attributes:
        xyxy_px: (n, 4) float32.
        score: (n,) float32.
        class_id: (n,) int32, index of the prompt.
    """

    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray


@dataclass(frozen=True, slots=True)
class GroundTruthBoxes:
    """Ground truth of one image.

    Attributes:
        xyxy_px: (m, 4) float32, box around the visible part of each object.
        label: (m,) int32, index of its label in `BenchFrames.labels`.
        counts: (m,) bool, False for an object that is too small or too hidden: it is neither a miss
            nor a false detection.
    """

    xyxy_px: np.ndarray
    label: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts of matches that add up over images.

    Attributes:
        wanted: number of ground-truth objects, or of reference boxes.
        found: number of detected boxes, without the ignored ones.
        hits: number of detected boxes that match a wanted one. Each wanted one is matched at most
            once.
        error: sum over the hits of |score - reference score| / reference score; 0 if they were
            matched with the ground truth, which has no scores.
    """

    wanted: int = 0
    found: int = 0
    hits: int = 0
    error: float = 0.0

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def shares(self) -> dict[str, float | None]:
        """Return `recall` and `precision`; None if there is nothing to divide by."""
        return {
            "recall": _ratio(self.hits, self.wanted),
            "precision": _ratio(self.hits, self.found),
        }


def _ratio(part: float, total: int) -> float | None:
    return round(part / total, 4) if total else None


def match_to_truth(xyxy_px: np.ndarray, truth: GroundTruthBoxes, relation: np.ndarray) -> Tally:
    """Match the boxes of one prompt in one image, highest score first, with the ground truth.

    A box is a hit if it overlaps an object with the prompt's name by `MATCH_IOU`, and no earlier
    box has hit that object; of several, it takes the one with the largest overlap. A box without a
    hit is ignored if it is in an object of the prompt's name that does not count, or in an object
    that is a kind of the prompt. Otherwise it is a false detection.

    `relation` is (labels,) uint8: that of each label to the prompt, such as `SAME_NAME`.
    """
    named = relation[truth.label] == SAME_NAME
    wanted = named & truth.counts
    ignored = (named & ~truth.counts) | (relation[truth.label] == KIND_OF_PROMPT)
    # (n, m): intersection over union, and the share of each box that is in each object.
    iou, share = overlaps(xyxy_px, truth.xyxy_px)
    free, hits, counted = wanted.copy(), 0, 0
    for i in range(len(xyxy_px)):
        overlapping = free & (iou[i] >= MATCH_IOU)
        if overlapping.any():
            free[np.argmax(np.where(overlapping, iou[i], -1.0))] = False
            hits, counted = hits + 1, counted + 1
        elif not (ignored & (share[i] >= COVERED)).any():
            counted += 1
    return Tally(int(wanted.sum()), counted, hits)


def match_to_reference(reference: DetectedBoxes, candidate: DetectedBoxes) -> Tally:
    """Match one image's boxes with those of another model: same prompt, IoU >= `MATCH_IOU`."""
    iou, _ = overlaps(candidate.xyxy_px, reference.xyxy_px)
    iou[candidate.class_id[:, None] != reference.class_id[None]] = 0.0
    hits, error = 0, 0.0
    for i in range(len(iou) if len(reference.score) else 0):
        # Each box takes the reference box with the largest overlap that no earlier one has taken.
        j = int(iou[i].argmax())
        if iou[i, j] >= MATCH_IOU:
            iou[:, j] = 0.0
            hits += 1
            error += abs(float(candidate.score[i]) / float(reference.score[j]) - 1.0)
    return Tally(len(reference.score), len(candidate.score), hits, error)


def agreement(reference: list[DetectedBoxes], candidate: list[DetectedBoxes]) -> dict[str, Any]:
    """Compare a variant's boxes with those of its FP32 model, frame by frame.

    Returns:
        `recall`, `precision`, `score_error` (mean relative difference of the hits' scores) and
        `boxes` (number of reference boxes).
    """
    tally = sum(
        itertools.starmap(match_to_reference, zip(reference, candidate, strict=True)), Tally()
    )
    return {**tally.shares(), "score_error": _ratio(tally.error, tally.hits), "boxes": tally.wanted}


def against_truth(
    found: list[DetectedBoxes],
    truth: list[GroundTruthBoxes],
    relations: np.ndarray,
    prompts: Sequence[str],
) -> dict[str, Any]:
    """Return recall and precision against the ground truth.

    Returns:
        `recall`, `precision`, `things` (objects that count), `boxes`, and `by_prompt`: prompt →
            [hits, objects, boxes].
    """
    by_prompt = {
        prompt: sum(
            (
                match_to_truth(boxes.xyxy_px[boxes.class_id == k], objects, relations[:, k])
                for boxes, objects in zip(found, truth, strict=True)
            ),
            Tally(),
        )
        for k, prompt in enumerate(prompts)
    }
    total = sum(by_prompt.values(), Tally())
    return {
        **total.shares(),
        "things": total.wanted,
        "boxes": total.found,
        "by_prompt": {p: [t.hits, t.wanted, t.found] for p, t in by_prompt.items()},
    }
