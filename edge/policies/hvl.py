"""Heuristic-vision-language goal scoring (VL-Nav III.D)."""

from __future__ import annotations

import numpy as np

from edge.config import PolicyHvl
from edge.geometry import SE2, optical_yaw_rad
from edge.loop.candidates import CandidatePool
from edge.mapping.grid import RollingMap
from edge.policies.kernels import hvl_scores, vl_scores
from edge.types import Detections


class Hvl:
    """Scores by eq. 8: what was seen in a frontier's direction, how near, how unknown."""

    def __init__(self, config: PolicyHvl) -> None:
        self.config = config
        self.uses_instances = config.instances
        self.delta_reached_m = config.delta_reached_m
        self.switch_margin = config.switch_margin
        self._ratio = np.zeros(0, np.float32)

    def score(
        self, pool: CandidatePool, grid: RollingMap, seen: Detections | None, pose: SE2
    ) -> None:
        """See `Policy.score`. The VL score stays from first sight; the rest is of now."""
        c = self.config
        if len(self._ratio) != len(pool.score):
            self._ratio = np.zeros_like(pool.score)
        if seen is not None and seen.observation.camera is not None:
            camera, at = seen.observation.camera, seen.observation.pose
            middle = 0.5 * (seen.xyxy_px[:, 0] + seen.xyxy_px[:, 2])
            mu = camera.bearing_of(middle)
            vl_scores(
                pool.xy_m, pool.kind, pool.first_seen_ns, pool.n, at.x_m, at.y_m,
                at.yaw_rad + optical_yaw_rad(seen.observation.T_base_camera),
                seen.observation.stamp_ns, camera.hfov_rad, mu,
                seen.score.astype(np.float64), seen.class_id, c.sigma_rad, pool.vl,
            )  # fmt: skip
        grid.unknown_ratio(pool.xy_m, pool.n, c.unknown_radius_m, self._ratio)
        hvl_scores(
            pool.xy_m, pool.kind, pool.vl[pool.channel], self._ratio, pool.n, pose.x_m, pose.y_m,
            c.w_dist, c.w_vl, c.unknown_k, c.heuristics, pool.score,
        )  # fmt: skip
