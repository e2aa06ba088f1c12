"""Policies `vlfm` and `directional` (ViTL eq. 9): choose the frontier with the best value near it.

A value map has a score for each cell and target: how promising the cell is. The two policies
differ in the source of the value maps (`Config.value_source`). VLFM writes full-view
similarity, weighted towards the centre of the view. ViTL spreads directional scores over the view.
"""

from __future__ import annotations

import numpy as np

from edge.config import PolicyDirectional, PolicyVlfm
from edge.policies.base import FRONTIER, Candidates, PolicyInput, Why


class ValueMapPolicy:
    """Policy that scores a frontier by the highest value within `radius_m` of it.

    A frontier without a value nearby has value 0. The score is the value + `config.nearness` /
    (1 + path length in m). A small `nearness` only breaks ties between equal values. Without any
    values, the robot therefore explores the nearest frontier.
    """

    def __init__(self, config: PolicyVlfm | PolicyDirectional) -> None:
        self._radius_m, self._nearness = config.radius_m, config.nearness
        self._score = np.zeros(0, np.float32)

    def score(self, context: PolicyInput) -> np.ndarray:
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
        """Do nothing: this policy has no memory. The value maps belong to the map."""


def count_frontiers(candidates: Candidates) -> int:
    """Return the number of frontiers; they come first among the candidates."""
    return int(np.count_nonzero(candidates.kind[: candidates.n] == FRONTIER))


def values_near(context: PolicyInput, n: int, radius_m: float, out: np.ndarray) -> None:
    """Write values of the active target near the first n candidates to out[:n]; NaN if none."""
    context.map.values.best(context.active, context.candidates.xy_m, n, radius_m, out)
