"""Policy `nearest_frontier`, a classical baseline: the nearest frontier, the surest instance."""

from __future__ import annotations

import numpy as np

from edge.config import PolicyNearest
from edge.policies.base import INSTANCE, PolicyInput, Why, distances_m


class NearestFrontierPolicy:
    """Policy that scores a frontier by eq. 5 of VL-Nav only."""

    def __init__(self, config: PolicyNearest) -> None:
        self.config = config

    def score(self, context: PolicyInput) -> np.ndarray:
        """See `Policy.score`."""
        candidates, n = context.candidates, context.candidates.n
        near = 1.0 / (1.0 + distances_m(context, self.config.distance))
        return np.where(candidates.kind[:n] == INSTANCE, candidates.confidence[:n], near)

    def reset(self, why: Why) -> None:
        """Do nothing: this policy has no memory."""
