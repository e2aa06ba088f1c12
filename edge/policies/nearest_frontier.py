"""The classical baseline: instances by confidence, frontiers by nearness alone."""

from __future__ import annotations

import numpy as np

from edge.config import PolicyNearest
from edge.policies.base import INSTANCE, Context, Why


class NearestFrontier:
    """Scores a frontier by eq. 5 of VL-Nav only."""

    def __init__(self, config: PolicyNearest) -> None:
        pass

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        candidates, n = context.candidates, context.candidates.n
        near = 1.0 / (1.0 + candidates.path_m[:n])
        return np.where(candidates.kind[:n] == INSTANCE, candidates.confidence[:n], near)

    def reset(self, why: Why) -> None:
        """It remembers nothing."""
