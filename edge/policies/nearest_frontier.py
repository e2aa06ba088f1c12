"""The classical baseline: instances by confidence, frontiers by nearness alone."""

from __future__ import annotations

import numpy as np

from edge.config import PolicyNearest
from edge.policies.base import FRONTIER, Context, Why


class NearestFrontier:
    """Scores a frontier by eq. 5 of VL-Nav only."""

    def __init__(self, config: PolicyNearest) -> None:
        pass

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`."""
        candidates, pose = context.candidates, context.pose
        xy_m, n = candidates.xy_m, candidates.n
        away = np.hypot(xy_m[:n, 0] - pose.x_m, xy_m[:n, 1] - pose.y_m)
        frontier = candidates.kind[:n] == FRONTIER
        return np.where(frontier, 1.0 / (1.0 + away), candidates.confidence[:n])

    def reset(self, why: Why) -> None:
        """It remembers nothing."""
