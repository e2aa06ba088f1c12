"""Scoring kernels (numba): arrays in, arrays out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def vl_scores(xy, kind, first_seen, n, x, y, yaw, stamp, fov, mu, alpha, label, sigma, vl):
    """S_VL of frontiers that no detector has looked at yet (VL-Nav eq. 2-4), in place.

    One score a target, all from the same look: an image without any box of a target says that
    the target is not there.

    Args:
        xy: (cap, 2) float32 map positions; kind: (cap,) int8, 0 = frontier; first_seen: (cap,)
            int64 stamps.
        x, y, yaw, stamp: pose and stamp of the image that was searched.
        fov: horizontal field of view in radians.
        mu, alpha: (k,) float64, bearing and confidence of each detection; label: (k,) int32, the
            target it is of.
        vl: (targets, cap) float32; NaN entries inside the field of view are filled.
    """
    for i in range(n):
        if kind[i] != 0 or not np.isnan(vl[0, i]) or first_seen[i] > stamp:
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
def hvl_scores(xy, kind, vl, ratio, n, x, y, w_dist, w_vl, k, heuristics, score):
    """S_HVL of frontiers (VL-Nav eq. 5, 7, 8); instances keep their VL score. In place.

    Args:
        kind: (cap,) int8, 0 = frontier; vl: (cap,) float32 of the active target, NaN counts as 0.
        ratio: (cap,) float32, share of unknown cells around each candidate (eq. 6).
        heuristics: False scores frontiers by S_VL alone (table I, "w/o Heuristics").
        score: (cap,) float32 output.
    """
    for i in range(n):
        s_vl = 0.0 if np.isnan(vl[i]) else vl[i]
        if kind[i] != 0 or not heuristics:
            score[i] = s_vl
            continue
        s_dist = 1.0 / (1.0 + math.hypot(xy[i, 0] - x, xy[i, 1] - y))
        s_unknown = 1.0 - math.exp(-k * ratio[i])
        score[i] = w_dist * s_dist + w_vl * s_vl * s_unknown
