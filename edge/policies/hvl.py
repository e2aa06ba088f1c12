"""Policy `hvl`: VL-Nav's heuristic-vision-language score of candidates (III.D).

S_HVL is the entire score of a frontier (eq. 8). S_VL is its vision-language part: the evidence of
detections in the frontier's direction (eq. 2 to 4). Numbers of equations are those of VL-Nav.
"""

from __future__ import annotations

import math

import numpy as np

from edge.config import UNKNOWN_RADIUS_M, PolicyHvl
from edge.geometry import optical_yaw_rad
from edge.jit import jit
from edge.perception.prior import table
from edge.policies.base import FRONTIER, PolicyInput, Why, distances_m
from edge.types import Detections

SIGMA_RAD = 0.1
"""Standard deviation in eq. 3: angular width of a detection's evidence."""
UNKNOWN_K = 2.0
"""Constant k of eq. 6."""


class HvlPolicy:
    """Policy that scores by eq. 8: detections in a frontier's direction, distance and unknown area.

    Eq. 3 uses every detection. A box of a target counts by its score. A box of another object
    counts by its score times its relation to the target (`relatedness`). Of the other objects, only
    the strongest evidence in a direction counts, not the sum: ten pillows are no better evidence
    of a bed than one.

    A frontier keeps the VL scores of its first observation (VL-Nav III.D). It has one VL score for
    each target (ViTL eq. 3), so no evidence is lost when the plan changes the target.
    """

    def __init__(self, config: PolicyHvl) -> None:
        self.config = config
        self._related_words: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._related = np.zeros((0, 0))
        self._n, self._id, self._vl = 0, np.zeros(0, np.int64), np.zeros((0, 0), np.float32)
        self._allocate(0, 0)

    def score(self, context: PolicyInput) -> np.ndarray:
        """Return S_HVL of each candidate; see `Policy.score`.

        A VL score keeps its first value. The other terms are computed again in each call.
        """
        c, candidates = self.config, context.candidates
        xy_m, kind, n = candidates.xy_m, candidates.kind, candidates.n
        if self._vl.shape != (len(context.targets), len(kind)):
            self._allocate(len(context.targets), len(kind))
        self._n = carry_over(
            kind, candidates.id, n, self._id, self._n, self._vl, self._old_id, self._old_vl
        )
        detections = context.detections
        if detections is not None and detections.observation.camera is not None:
            observation, camera = detections.observation, detections.observation.camera
            pose = observation.pose
            mu, alpha = self._evidence(detections, context.targets)
            vl_scores(
                xy_m, candidates.first_seen_ns, self._n, pose.x_m, pose.y_m,
                pose.yaw_rad + optical_yaw_rad(observation.T_base_camera), observation.stamp_ns,
                camera.hfov_rad, mu, alpha, len(detections), SIGMA_RAD, self._vl,
            )  # fmt: skip
        context.map.unknown_ratio(xy_m, n, UNKNOWN_RADIUS_M, self._ratio)
        away_m = distances_m(context, c.distance)
        hvl_scores(
            kind, candidates.confidence, self._vl[context.active], self._ratio, away_m, n,
            c.w_dist, c.w_vl, UNKNOWN_K, c.heuristics, self._score,
        )  # fmt: skip
        return self._score

    def _evidence(
        self, detections: Detections, targets: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the bearing of each box and its evidence for each target.

        The boxes of targets come first, then the boxes of other objects.

        Returns:
            mu (k,) float64, bearings in radians; alpha (k, targets) float64, evidence.
        """
        alpha = np.zeros((len(detections), len(targets)))
        alpha[np.arange(len(detections)), detections.class_id] = detections.score
        centre_u_px = 0.5 * (detections.xyxy_px[:, 0] + detections.xyxy_px[:, 2])
        others, weight = detections.context, self.config.w_context
        if others is not None and len(others) and weight > 0.0:
            if self._related_words != (others.words, targets):
                self._related_words = (others.words, targets)
                self._related = relatedness(others.words, targets)
            others_alpha = weight * others.score[:, None] * self._related[others.class_id]
            alpha = np.concatenate((alpha, others_alpha))
            others_u_px = 0.5 * (others.xyxy_px[:, 0] + others.xyxy_px[:, 2])
            centre_u_px = np.append(centre_u_px, others_u_px)
        camera = detections.observation.camera
        assert camera is not None  # the caller checked
        return camera.bearing_of(centre_u_px), alpha

    def reset(self, why: Why) -> None:
        """Forget all frontiers, unless only the map window moved."""
        if why != "map rolled":
            self._n = 0

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return the first VL score of each frontier; see `edge.policies.base.StatefulPolicy`."""
        return {"id": self._id[: self._n].copy(), "vl": self._vl[:, : self._n].copy()}

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Restore the first VL scores; see `edge.policies.base.StatefulPolicy`."""
        ids, vl = state["id"], state["vl"]
        if ids.ndim != 1 or vl.ndim != 2 or vl.shape[1] != len(ids) or np.isinf(vl).any():
            raise ValueError("policy hvl: the saved scores do not fit the saved ids of frontiers")
        self._allocate(len(vl), len(ids))
        self._id[:], self._vl[:], self._n = ids, vl, len(ids)

    def _allocate(self, targets: int, capacity: int) -> None:
        """Allocate VL scores for `capacity` frontiers.

        Old scores are kept if the number of targets is the same.
        """
        n = min(self._n, capacity) if len(self._vl) == targets else 0
        ids, vl = self._id[:n], self._vl[:, :n]
        self._id, self._old_id = (np.zeros(capacity, np.int64) for _ in range(2))
        self._vl, self._old_vl = (np.zeros((targets, capacity), np.float32) for _ in range(2))
        self._ratio, self._score = (np.zeros(capacity, np.float32) for _ in range(2))
        self._n, self._id[:n] = n, ids
        if n:
            self._vl[:, :n] = vl


def relatedness(words: tuple[str, ...], targets: tuple[str, ...]) -> np.ndarray:
    """Return the relation of words to targets: 1 - 1 / r, or 0 if r is at most 1.

    r is the likelihood ratio of a room containing one object, given that it contains the other.

    Returns:
        (words, targets) float64 in [0, 1); 0 for words outside the co-occurrence table.
    """
    known = table.load()
    ratio = np.array(
        [[known.likelihood_ratio((word, target))[0, 1] for target in targets] for word in words]
    )
    return 1.0 - 1.0 / np.maximum(ratio.reshape(len(words), len(targets)), 1.0)


@jit
def carry_over(kind, ids, n, known, n_known, vl, old, old_vl):
    """Reorder the stored frontiers into the order of the candidates, in place.

    Args:
        kind: (cap,) int8 of `n` candidates, frontiers first.
        ids: (cap,) int64 of the candidates.
        n: number of candidates.
        known: (cap,) int64, ids of the frontiers in the first `n_known` columns of `vl`.
        n_known: number of stored frontiers.
        vl: (targets, cap) float32; a frontier that was not stored gets NaN.
        old: scratch, like `known`.
        old_vl: scratch, like `vl`.

    Returns:
        The number of frontiers.
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
        # The order rarely changes, so the search begins after the last match.
        for _ in range(n_known):
            j = j + 1 if j + 1 < n_known else 0
            if old[j] == ids[i]:
                vl[:, i] = old_vl[:, j]
                break
    return count


@jit
def vl_scores(xy, first_seen, n, x, y, yaw, stamp, fov, mu, alpha, n_target_boxes, sigma, vl):
    """Write S_VL of frontiers that no image covered yet (VL-Nav eq. 2-4), in place.

    All targets of a frontier get their score from the same image. An image without any box of a
    target is evidence that the target is not there.

    Args:
        xy: (cap, 2) float32 map positions, `n` frontiers first.
        first_seen: (cap,) int64 stamps.
        n: number of frontiers.
        x: x of the robot in `map` when the image was taken, in metres.
        y: y of the robot in `map` when the image was taken, in metres.
        yaw: heading of the camera in `map` when the image was taken, in radians.
        stamp: stamp of the image.
        fov: horizontal field of view in radians.
        mu: (k,) float64, bearing of each detection.
        alpha: (k, targets) float64, evidence of each detection for each target.
        n_target_boxes: number of detections of targets, which come first and are summed (eq. 3).
            Of the others, only the strongest counts.
        sigma: standard deviation of eq. 3 in radians.
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
        for t in range(vl.shape[0]):
            total = strongest = 0.0
            for k in range(len(mu)):
                if alpha[k, t] == 0.0:
                    continue
                z = (offset - mu[k]) / sigma
                evidence = alpha[k, t] * math.exp(-0.5 * z * z)
                if k < n_target_boxes:
                    total += evidence
                else:
                    strongest = max(strongest, evidence)
            vl[t, i] = (total + strongest) * confidence


@jit
def hvl_scores(kind, confidence, vl, ratio, away, n, w_dist, w_vl, unknown_k, heuristics, score):
    """Write S_HVL of frontiers (eq. 5, 7, 8), and the confidence of instances, as the scores.

    Args:
        kind: (cap,) int8.
        confidence: (cap,) float32 of instances.
        vl: (cap,) float32 of frontiers, for the active target; NaN counts as 0.
        ratio: (cap,) float32, ratio of unknown cells around each candidate (eq. 6).
        away: (n,) float32, distance in metres to each; inf if unreachable.
        n: number of candidates.
        w_dist: weight of the distance term.
        w_vl: weight of the VL term.
        unknown_k: constant k of eq. 6.
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
        s_dist = 1.0 / (1.0 + away[i])
        s_unknown = 1.0 - math.exp(-unknown_k * ratio[i])
        score[i] = w_dist * s_dist + w_vl * s_vl * s_unknown
