"""Exploration policy `search`: prefers candidates that show much new area after a short drive."""

from __future__ import annotations

import numpy as np

from edge.config import PolicySearch
from edge.policies.base import FRONTIER, INSTANCE, PolicyInput, Why

START_M = 1.0
"""Added to every path length, so that the score of a near candidate stays finite."""
SURE = 0.95
"""Probability that a confirmed object is the target and still there."""


class SearchPolicy:
    """Policy that scores frontiers and turns on the spot by new area over path length.

    The score is sqrt(new area in m²) / (path length in m + `START_M`). The square root gives
    diminishing returns: each additional square metre is worth less. If there is a prior (rooms and
    objects near which the target is likely), a frontier's score is multiplied by its likelihood
    ratio. A known object is scored by the probability that it is the target, over its path length
    + `START_M`: to visit objects in this order makes the expected path shortest. The probability
    is `SURE` for a confirmed object, else sqrt(confidence).
    """

    def __init__(self, config: PolicySearch) -> None:
        self.config = config
        self._ratio = np.ones(0, np.float32)

    def score(self, context: PolicyInput) -> np.ndarray:
        """See `Policy.score`."""
        candidates = context.candidates
        n = candidates.n
        kind, path_m = candidates.kind[:n], candidates.path_m[:n]
        score = np.sqrt(np.maximum(candidates.gain_m2[:n], 0.0)) / (START_M + path_m)
        n_frontiers = int(np.count_nonzero(kind == FRONTIER))
        if context.prior is not None:
            if len(self._ratio) < len(candidates.id):
                self._ratio = np.ones(len(candidates.id), np.float32)
            context.prior.likelihood_ratio(
                context.target, candidates.xy_m, n_frontiers, self._ratio
            )
            score[:n_frontiers] *= self._ratio[:n_frontiers]
        return np.where(kind == INSTANCE, self._instance_scores(context), score)

    def _instance_scores(self, context: PolicyInput) -> np.ndarray:
        """Return (n,) scores of known objects; see the class."""
        candidates, pose = context.candidates, context.pose
        n = candidates.n
        xy_m, path_m = candidates.xy_m[:n], candidates.path_m[:n]
        straight_m = np.hypot(xy_m[:, 0] - pose.x_m, xy_m[:, 1] - pose.y_m)
        distance_m = np.where(np.isfinite(path_m), path_m, straight_m)
        probability = np.where(candidates.confirmed[:n], SURE, np.sqrt(candidates.confidence[:n]))
        return probability / (START_M + distance_m)

    def reset(self, why: Why) -> None:
        """Do nothing: this policy has no memory."""
