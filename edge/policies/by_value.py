"""The frontier with the best value near it: VLFM's choice, and ViTL's (eq. 9).

The two differ by what the value maps are written from (`Config.value_source`): whole-view
similarity, weighted towards the middle of the view, or directional scores, spread over it.
"""

from __future__ import annotations

import numpy as np

from edge.config import PolicyDirectional, PolicyVlfm
from edge.policies.base import FRONTIER, Candidates, Context, Why


class ByValue:
    """Scores a frontier by the highest value within `radius_m` of it.

    A frontier near which nothing was said has value 0. `config.nearness` over a metre more than the
    path is added: the smaller it is, the more it only makes the nearest of equals the best, so that
    the robot explores as a nearest-frontier searcher while nothing was said at all.
    """

    def __init__(self, config: PolicyVlfm | PolicyDirectional) -> None:
        self._radius_m, self._nearness = config.radius_m, config.nearness
        self._score = np.zeros(0, np.float32)

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        candidates = context.candidates
        n = count_frontiers(candidates)
        if len(self._score) < len(candidates.kind):
            self._score = np.zeros(len(candidates.kind), np.float32)
        score = self._score
        values_near(context, n, self._radius_m, score)
        score[:n] = np.nan_to_num(score[:n]) + self._nearness / (1.0 + candidates.path_m[:n])
        score[n : candidates.n] = candidates.confidence[n : candidates.n]
        return score

    def reset(self, why: Why) -> None:
        """It remembers nothing: the value maps are the map's."""


def count_frontiers(candidates: Candidates) -> int:
    """How many of the candidates are frontiers; they come first."""
    return int(np.count_nonzero(candidates.kind[: candidates.n] == FRONTIER))


def values_near(context: Context, n: int, radius_m: float, out: np.ndarray) -> None:
    """Values of the active target near the first n candidates, into out[:n]; NaN: nothing said."""
    context.map.values.best(context.active, context.candidates.xy_m, n, radius_m, out)
