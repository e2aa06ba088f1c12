"""The classical baseline: instances by confidence, frontiers by nearness alone."""

from __future__ import annotations

import numpy as np

from edge.config import PolicyNearest
from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, CandidatePool
from edge.mapping.grid import RollingMap
from edge.types import Detections


class NearestFrontier:
    """Scores a frontier by eq. 5 of VL-Nav only."""

    def __init__(self, config: PolicyNearest) -> None:
        self.uses_instances = True
        self.delta_reached_m = config.delta_reached_m
        self.switch_margin = config.switch_margin

    def score(
        self, pool: CandidatePool, grid: RollingMap, seen: Detections | None, pose: SE2
    ) -> None:
        """See `Policy.score`."""
        n = pool.n
        away = np.hypot(pool.xy_m[:n, 0] - pose.x_m, pool.xy_m[:n, 1] - pose.y_m)
        sight = pool.vl[pool.channel, :n]
        pool.score[:n] = np.where(pool.kind[:n] == FRONTIER, 1.0 / (1.0 + away), sight)
