"""What a policy is, and what all of them share: algorithm 2 of VL-Nav."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.mapping.grid import RollingMap
from edge.types import Detections


class Policy(Protocol):
    """Scores candidates; `select` picks among them.

    Attributes:
        uses_instances: whether what may be the target is a candidate; else only what the detector
            confirmed in passing is (ablation "w/o IBTP").
        delta_reached_m: candidates nearer than this are discarded (VL-Nav algorithm 2).
        switch_margin: how much better another candidate must be for the goal to change,
            as a fraction of the present goal's score.
    """

    uses_instances: bool
    delta_reached_m: float
    switch_margin: float

    def score(
        self, pool: CandidatePool, grid: RollingMap, seen: Detections | None, pose: SE2
    ) -> None:
        """Fill `pool.score[: pool.n]` (and `pool.vl` of candidates seen for the first time).

        Args:
            seen: the newest detections, `class_id` counting the pool's channels, or None when
                nothing new came.
            pose: where the robot is now.
        """
        ...


def ranked(pool: CandidatePool, pose: SE2, delta_reached_m: float) -> np.ndarray:
    """Indices of the candidates in the order algorithm 2 would take them.

    Instances come before all frontiers, confirmed ones first, each by score; frontiers within
    `delta_reached_m` of the robot, and discarded candidates, are left out.

    Returns:
        (k,) int64.
    """
    n = pool.n
    dx, dy = pool.xy_m[:n, 0] - pose.x_m, pool.xy_m[:n, 1] - pose.y_m
    # An instance is never "too close": the mission verifies it on the spot instead.
    far = (dx * dx + dy * dy > delta_reached_m**2) | (pool.kind[:n] == INSTANCE)
    alive = np.flatnonzero(far & ~pool.blocked[:n])
    order = np.lexsort(
        (pool.id[alive], -pool.score[alive], ~pool.sure[alive], pool.kind[alive] == FRONTIER)
    )
    return alive[order]


def bearing(from_x_m: float, from_y_m: float, to_x_m: float, to_y_m: float) -> float:
    """Direction in `map` from one point to another, radians."""
    return math.atan2(to_y_m - from_y_m, to_x_m - from_x_m)
