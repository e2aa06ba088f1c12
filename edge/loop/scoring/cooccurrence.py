"""Scores of views from objects that share a room, without a vision-language model.

`edge.loop.scoring.scorers` uses them where the configuration names no such model.

The table of objects that share a room was counted over furnished houses (see
`edge.perception.prior.table`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge import names
from edge.perception.prior import table
from edge.perception.scoring.choice.question import FrontierChoice, MarkedView
from edge.types import Detections


class RelatedScores:
    """Scores an entire view by the detector's boxes, one score for each target (like VLFM).

    The score of a target is the maximum of score(box) x P(target in the room | class of the box in
    the room) over all boxes, including context boxes. A box of the target itself has probability 1.
    The score is 0 without boxes. For a target that is not in the table, only its own boxes count.
    """

    def __init__(self) -> None:
        self._table = table.load()
        self._computed_for: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._p_given_word = np.zeros((0, 0))

    def __call__(self, detections: Detections) -> np.ndarray:
        """Return (n,) float32 in [0, 1], a score for each prompt."""
        targets, context = detections.prompts, detections.context
        words = () if context is None else context.words
        if (targets, words) != self._computed_for:
            self._computed_for = targets, words
            self._p_given_word = p_object_given_word(self._table, targets, (*targets, *words))
        best = np.zeros(len(targets), np.float32)
        boxes = [(detections.class_id, detections.score)]
        if context is not None:
            boxes.append((context.class_id + len(targets), context.score))
        for word, score in boxes:
            if len(word):
                np.maximum(best, (self._p_given_word[:, word] * score).max(axis=1), out=best)
        return best


class PriorChoice:
    """Chooses between frontiers by the prior: computes ViTL's two answers without a model.

    The answers are the probability of each direction, and that the view leads to the target.

    The probability of a direction is its share of the likelihood ratios. "Elsewhere" has the ratio
    1 of an average place. The odds that the view leads to the target at all are the ratio of its
    best direction.
    """

    name = "cooccurrence, by the prior"

    def prepare(self, view: MarkedView) -> MarkedView:
        return view

    def answer(self, view: MarkedView) -> FrontierChoice | None:
        """Return the choice, or None if the view has no likelihood ratios."""
        if view.likelihood_ratio is None:
            return None
        total, best = 1.0 + float(view.likelihood_ratio.sum()), float(view.likelihood_ratio.max())
        return FrontierChoice(
            stamp_ns=view.observation.stamp_ns,
            target=view.target,
            ids=tuple(mark.id for mark in view.marks),
            p=(view.likelihood_ratio / total).astype(np.float32),
            elsewhere=1.0 / total,
            scene=best / (1.0 + best),
        )

    def close(self) -> None:
        """Do nothing: there is no background work."""


def p_object_given_word(
    known: table.ObjectPrior, objects: Sequence[str], words: Sequence[str]
) -> np.ndarray:
    """Return P(a room holds the object | it holds the word).

    This is the share of rooms that hold the object, times the likelihood ratio of the pair.

    Returns:
        (n, m) float64: 1 if both are the same, 0 if the table lacks one of them.
    """
    p = known.likelihood_ratio([*objects, *words])[: len(objects), len(objects) :]
    for i, name in enumerate(objects):
        row = known.row(name)
        p[i] *= 0.0 if row < 0 else known.rooms_with_both[row, row] / known.n_rooms
        for j, word in enumerate(words):
            if names.same_name(name, word):
                p[i, j] = 1.0
            elif known.row(word) < 0:
                p[i, j] = 0.0
    return np.minimum(p, 1.0)
