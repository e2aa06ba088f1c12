"""What a view promises by what stands in it: scores of views that need no vision-language model.

The table of which things share a room was counted over furnished houses (see
`edge.mission.planning.cooccurrence`).
"""

from __future__ import annotations

import numpy as np

from edge.mission.planning import cooccurrence
from edge.types import Detections


class RelatedScores:
    """A score of VLFM's kind, one for a whole view, from the boxes that a detector found in it.

    For each target it is the highest of score(box) x P(target in the room | the box's word is
    there) over all boxes, those of context words included; a box of the target itself counts in
    full. It is 0 where nothing was found, and for a target that the table does not know only its
    own boxes count.
    """

    def __init__(self) -> None:
        self._table = cooccurrence.load()
        self._of: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._p = np.zeros((0, 0))

    def __call__(self, detections: Detections) -> np.ndarray:
        """(n,) float32 in [0, 1], one for each prompt."""
        targets, around = detections.prompts, detections.context
        words = () if around is None else around.words
        if (targets, words) != self._of:
            self._of, self._p = (targets, words), self._table.given(targets, (*targets, *words))
        best = np.zeros(len(targets), np.float32)
        boxes = [(detections.class_id, detections.score)]
        if around is not None:
            boxes.append((around.class_id + len(targets), around.score))
        for word, score in boxes:
            if len(word):
                np.maximum(best, (self._p[:, word] * score).max(axis=1), out=best)
        return best
