"""What a view promises by what stands in it: scores of views that need no vision-language model.

The table of which things share a room was counted over furnished houses (see
`edge.perception.prior.table`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge import names
from edge.perception.prior import table
from edge.perception.scoring.choice.question import Choice, View
from edge.types import Detections


class RelatedScores:
    """A score of VLFM's kind, one for a whole view, from the boxes that a detector found in it.

    For each target it is the highest of score(box) x P(target in the room | the box's word is
    there) over all boxes, those of context words included; a box of the target itself counts in
    full. It is 0 where nothing was found, and for a target that the table does not know only its
    own boxes count.
    """

    def __init__(self) -> None:
        self._table = table.load()
        self._of: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._p = np.zeros((0, 0))

    def __call__(self, detections: Detections) -> np.ndarray:
        """(n,) float32 in [0, 1], one for each prompt."""
        targets, around = detections.prompts, detections.context
        words = () if around is None else around.words
        if (targets, words) != self._of:
            self._of = targets, words
            self._p = given(self._table, targets, (*targets, *words))
        best = np.zeros(len(targets), np.float32)
        boxes = [(detections.class_id, detections.score)]
        if around is not None:
            boxes.append((around.class_id + len(targets), around.score))
        for word, score in boxes:
            if len(word):
                np.maximum(best, (self._p[:, word] * score).max(axis=1), out=best)
        return best


class PriorChoice:
    """ViTL's two answers by the prior: a scorer of views that asks no model.

    A direction's probability is its lift's share, where "elsewhere" has the lift 1 of an average
    place; that the view leads to the target at all has the odds of its best direction.
    """

    name = "cooccurrence, by the prior"

    def look(self, view: View) -> View:
        return view

    def answer(self, view: View) -> Choice | None:
        """None where the prior was not asked."""
        if view.lift is None:
            return None
        total, best = 1.0 + float(view.lift.sum()), float(view.lift.max())
        return Choice(
            stamp_ns=view.observation.stamp_ns,
            target=view.target,
            ids=tuple(mark.id for mark in view.marks),
            p=(view.lift / total).astype(np.float32),
            elsewhere=1.0 / total,
            scene=best / (1.0 + best),
        )

    def close(self) -> None:
        """Nothing to give up."""


def given(known: table.Table, things: Sequence[str], words: Sequence[str]) -> np.ndarray:
    """P(a room holds the thing | it holds the word): the thing's share of all rooms, times the
    lift.

    Returns:
        (n, m) float64: 1 where both are the same, 0 where the table lacks either.
    """
    p = known.lift([*things, *words])[: len(things), len(things) :]
    for i, thing in enumerate(things):
        row = known.row(thing)
        p[i] *= 0.0 if row < 0 else known.rooms_with_both[row, row] / known.n_rooms
        for j, word in enumerate(words):
            if names.same(thing, word):
                p[i, j] = 1.0
            elif known.row(word) < 0:
                p[i, j] = 0.0
    return np.minimum(p, 1.0)
