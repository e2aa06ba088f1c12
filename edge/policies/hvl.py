"""Heuristic-vision-language goal scoring (VL-Nav III.D)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from edge.config import PolicyHvl
from edge.geometry import optical_yaw_rad
from edge.policies.base import FRONTIER, Context, Why


class Hvl:
    """Scores by eq. 8: what was seen in a frontier's direction, how near, how unknown.

    A frontier's VL scores stay as they were at its first sight (VL-Nav III.D). It has one for each
    target of the mission (ViTL eq. 3), so that nothing that was seen is lost when the plan turns
    to another target.
    """

    def __init__(self, config: PolicyHvl) -> None:
        self.config = config
        self._remember(0, 0)

    def score(self, context: Context) -> np.ndarray:
        """See `Policy.score`. The VL score stays from first sight; the rest is of now."""
        c, candidates, pose = self.config, context.candidates, context.pose
        xy_m, kind, n = candidates.xy_m, candidates.kind, candidates.n
        if self._vl.shape != (len(context.targets), len(kind)):
            self._remember(len(context.targets), len(kind))
        self._n = carry_over(
            kind, candidates.id, n, self._id, self._n, self._vl, self._old_id, self._old_vl
        )
        seen = context.detections
        if seen is not None and seen.observation.camera is not None:
            camera, at = seen.observation.camera, seen.observation.pose
            middle = 0.5 * (seen.xyxy_px[:, 0] + seen.xyxy_px[:, 2])
            mu = camera.bearing_of(middle)
            vl_scores(
                xy_m, candidates.first_seen_ns, self._n, at.x_m, at.y_m,
                at.yaw_rad + optical_yaw_rad(seen.observation.T_base_camera),
                seen.observation.stamp_ns, camera.hfov_rad, mu,
                seen.score.astype(np.float64), seen.class_id, c.sigma_rad, self._vl,
            )  # fmt: skip
        context.map.unknown_ratio(xy_m, n, c.unknown_radius_m, self._ratio)
        hvl_scores(
            xy_m, kind, candidates.confidence, self._vl[context.active], self._ratio, n,
            pose.x_m, pose.y_m, c.w_dist, c.w_vl, c.unknown_k, c.heuristics, self._score,
        )  # fmt: skip
        return self._score

    def reset(self, why: Why) -> None:
        """Another mission has other targets, and another map other frontiers."""
        if why != "map rolled":
            self._n = 0

    def _remember(self, targets: int, capacity: int) -> None:
        """Room for the VL scores of so many frontiers; none is known yet."""
        self._n = 0
        self._id, self._old_id = (np.zeros(capacity, np.int64) for _ in range(2))
        self._vl, self._old_vl = (np.zeros((targets, capacity), np.float32) for _ in range(2))
        self._ratio, self._score = (np.zeros(capacity, np.float32) for _ in range(2))


@njit(nogil=True, cache=True)
def carry_over(kind, ids, n, known, n_known, vl, old, old_vl):
    """Bring what is remembered of frontiers into the order of the candidates, in place.

    Args:
        kind, ids: (cap,) int8 and int64, of `n` candidates, frontiers first.
        known: (cap,) int64, the frontiers that the first `n_known` columns of `vl` are of.
        vl: (targets, cap) float32; what is not remembered becomes NaN.
        old, old_vl: scratch, like `known` and `vl`.

    Returns:
        How many frontiers there are.
    """
    old[:n_known] = known[:n_known]
    old_vl[:, :n_known] = vl[:, :n_known]
    j, count = n_known - 1, 0
    for i in range(n):
        if kind[i] != FRONTIER:
            break
        count += 1
        known[i] = ids[i]
        vl[:, i] = np.nan
        # The order hardly ever changes: the search begins behind the one found last.
        for _ in range(n_known):
            j = j + 1 if j + 1 < n_known else 0
            if old[j] == ids[i]:
                vl[:, i] = old_vl[:, j]
                break
    return count


@njit(nogil=True, cache=True)
def vl_scores(xy, first_seen, n, x, y, yaw, stamp, fov, mu, alpha, label, sigma, vl):
    """S_VL of frontiers that no detector has looked at yet (VL-Nav eq. 2-4), in place.

    One score a target, all from the same look: an image without any box of a target says that
    the target is not there.

    Args:
        xy: (cap, 2) float32 map positions, `n` frontiers first; first_seen: (cap,) int64 stamps.
        x, y, yaw, stamp: pose and stamp of the image that was searched.
        fov: horizontal field of view in radians.
        mu, alpha: (k,) float64, bearing and confidence of each detection; label: (k,) int32, the
            target it is of.
        vl: (targets, cap) float32; NaN entries inside the field of view are filled.
    """
    for i in range(n):
        if not np.isnan(vl[0, i]) or first_seen[i] > stamp:
            continue
        offset = math.atan2(xy[i, 1] - y, xy[i, 0] - x) - yaw
        offset = (offset + math.pi) % (2.0 * math.pi) - math.pi
        # cos^2 rises again beyond the field of view, so eq. 4 holds only inside it.
        if abs(offset) > 0.5 * fov:
            continue
        confidence = math.cos(offset / (0.5 * fov) * 0.5 * math.pi) ** 2
        vl[:, i] = 0.0
        for k in range(len(mu)):
            z = (offset - mu[k]) / sigma
            vl[label[k], i] += alpha[k] * math.exp(-0.5 * z * z) * confidence


@njit(nogil=True, cache=True)
def hvl_scores(
    xy, kind, confidence, vl, ratio, n, x, y, w_dist, w_vl, k, heuristics, score
):  # fmt: skip
    """S_HVL of frontiers (VL-Nav eq. 5, 7, 8); an instance's VL score is its confidence. In place.

    Args:
        kind: (cap,) int8; confidence: (cap,) float32 of instances.
        vl: (cap,) float32 of frontiers, for the active target; NaN counts as 0.
        ratio: (cap,) float32, share of unknown cells around each candidate (eq. 6).
        heuristics: False scores frontiers by S_VL alone (table I, "w/o Heuristics").
        score: (cap,) float32 output.
    """
    for i in range(n):
        if kind[i] != FRONTIER:
            score[i] = confidence[i]
            continue
        s_vl = 0.0 if np.isnan(vl[i]) else vl[i]
        if not heuristics:
            score[i] = s_vl
            continue
        s_dist = 1.0 / (1.0 + math.hypot(xy[i, 0] - x, xy[i, 1] - y))
        s_unknown = 1.0 - math.exp(-k * ratio[i])
        score[i] = w_dist * s_dist + w_vl * s_vl * s_unknown
