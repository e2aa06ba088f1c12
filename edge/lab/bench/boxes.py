"""How found boxes compare: with what is there, and with what another model found. Arrays only."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from edge.geometry import overlaps

MATCH_IOU = 0.5
COVERED = 0.5
"""A box that lies this much in something that does not count, does not count either."""
NO, KIND, NAMED = 0, 1, 2
"""How a label answers to a prompt: not at all, as a kind of it (armchair, chair), by its name."""


@dataclass(frozen=True, slots=True)
class Found:
    """Boxes of one picture, highest score first.

    Attributes:
        xyxy_px: (n, 4) float32.
        score: (n,) float32.
        class_id: (n,) int32, index of the prompt.
    """

    xyxy_px: np.ndarray
    score: np.ndarray
    class_id: np.ndarray


@dataclass(frozen=True, slots=True)
class Truth:
    """What is in one picture.

    Attributes:
        xyxy_px: (m, 4) float32 boxes of what is visible of each thing.
        label: (m,) int32, index of its label.
        counts: (m,) bool; what is too small or too hidden is neither missed nor wrongly found.
    """

    xyxy_px: np.ndarray
    label: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts that add up over pictures.

    Attributes:
        wanted: things, or boxes of the reference.
        found: boxes that count.
        hits: how many of them are one of the wanted, each of which is hit once.
        error: sum over the hits of |score - reference's| / reference's.
    """

    wanted: int = 0
    found: int = 0
    hits: int = 0
    error: float = 0.0

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def shares(self) -> dict[str, float | None]:
        """`recall` of what is wanted, `precision` of what was found; None where nothing is."""
        return {
            "recall": _ratio(self.hits, self.wanted),
            "precision": _ratio(self.hits, self.found),
        }


def _ratio(part: float, whole: int) -> float | None:
    return round(part / whole, 4) if whole else None


def judge(xyxy_px: np.ndarray, truth: Truth, how: np.ndarray) -> Tally:
    """Hold the boxes of one prompt in one picture against what is there.

    A box hits the thing of its prompt's name that it covers best, if no better box did. One that
    hits nothing is left out of the count where it lies in something that answers to its prompt
    but does not count, or is a kind of it; otherwise it is wrong.

    Args:
        xyxy_px: (n, 4) float32, highest score first.
        how: (labels,) of NO, KIND, NAMED.
    """
    named = how[truth.label] == NAMED
    wanted = named & truth.counts
    spared = (named & ~truth.counts) | (how[truth.label] == KIND)
    iou, share = overlaps(xyxy_px, truth.xyxy_px)
    free, hits, counted = wanted.copy(), 0, 0
    for i in range(len(xyxy_px)):
        mine = free & (iou[i] >= MATCH_IOU)
        if mine.any():
            free[np.argmax(np.where(mine, iou[i], -1.0))] = False
            hits, counted = hits + 1, counted + 1
        elif not (spared & (share[i] >= COVERED)).any():
            counted += 1
    return Tally(int(wanted.sum()), counted, hits)


def agree(reference: Found, candidate: Found) -> Tally:
    """Hold one picture's boxes against those of another model: same prompt, IoU of `MATCH_IOU`."""
    iou, _ = overlaps(candidate.xyxy_px, reference.xyxy_px)
    iou[candidate.class_id[:, None] != reference.class_id[None]] = 0.0
    hits, error = 0, 0.0
    for i in range(len(iou) if len(reference.score) else 0):
        j = int(iou[i].argmax())
        if iou[i, j] >= MATCH_IOU:
            iou[:, j] = 0.0
            hits += 1
            error += abs(float(candidate.score[i]) / float(reference.score[j]) - 1.0)
    return Tally(len(reference.score), len(candidate.score), hits, error)


def agreement(reference: list[Found], candidate: list[Found]) -> dict[str, Any]:
    """How a variant's boxes compare with those of its FP32 model, frame by frame.

    `score_error` is the mean relative difference of the hits' scores, `boxes` the reference's.
    """
    tally = sum(itertools.starmap(agree, zip(reference, candidate, strict=True)), Tally())
    return {
        **tally.shares(),
        "score_error": _ratio(tally.error, tally.hits),
        "boxes": tally.wanted,
    }


def against_truth(
    found: list[Found], truth: list[Truth], answers: np.ndarray, prompts: Sequence[str]
) -> dict[str, Any]:
    """Recall and precision against what is there; `by_prompt` has hits, things and boxes.

    Args:
        answers: (labels, prompts); see `frames.answers_of`.
    """
    by_prompt = {
        prompt: sum(
            (
                judge(boxes.xyxy_px[boxes.class_id == k], real, answers[:, k])
                for boxes, real in zip(found, truth, strict=True)
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
