"""Our search: what a place would show, over the way there."""

from __future__ import annotations

import numpy as np

from edge.config import PolicySearch
from edge.policies.base import INSTANCE, LOOK, Context, Why


class Search:
    """Scores frontiers and looks by the root of the area that they show, over their way."""

    def __init__(self, config: PolicySearch) -> None:
        self.config = config

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        c, candidates = self.config, context.candidates
        n = candidates.n
        kind, path_m = candidates.kind[:n], candidates.path_m[:n]
        score = np.sqrt(np.maximum(candidates.gain_m2[:n], 0.0)) / (c.start_m + path_m)
        score[kind == LOOK] *= c.look_weight
        return np.where(kind == INSTANCE, candidates.confidence[:n], score)

    def reset(self, why: Why) -> None:
        """It remembers nothing."""
