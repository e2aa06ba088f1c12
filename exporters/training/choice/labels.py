"""What is right in a view: which directions lead to a target, and whether any does."""

from __future__ import annotations

import numpy as np

from edge.perception.runtime.card_types import MARK_FIELDS
from edge.perception.scoring.choice.mark_scorer import FAR_M
from edge.perception.scoring.choice.question import MAX_MARKS
from exporters.training.choice.collect import BEFORE, HW, Views

SOFT_M = 1.5
"""A direction so much longer than the best is right by 1/e of it."""
DETOUR_M, DETOUR_SHARE = 1.5, 0.25
"""A way is near the shortest that is longer by at most so much, and this share of it."""
RIGHT_M = 0.5
"""Directions that differ by less are as good as each other."""


def marks_of(views: Views) -> np.ndarray:
    """(n, MAX_MARKS, MARK_FIELDS) float32, as `MarksCard` has them."""
    out = np.zeros((len(views), MAX_MARKS, MARK_FIELDS), np.float32)
    out[..., 0] = (views.marks[..., 0] + 0.5) / HW[1]
    out[..., 1] = (views.marks[..., 1] + 0.5) / HW[0]
    out[..., 2:4] = views.marks[..., 2:]
    out[..., 4] = np.minimum(views.path_m, FAR_M)
    out[..., 5], out[..., -1] = views.gain_m2, shown(views)
    return out * out[..., -1:]


def shown(views: Views) -> np.ndarray:
    """(n, MAX_MARKS) bool, where there is a mark."""
    return np.arange(MAX_MARKS) < views.count[:, None]


def asked(views: Views) -> np.ndarray:
    """(n, t) bool: worth asking, since the robot does not know of the target from elsewhere."""
    reaches = np.isfinite(np.minimum(views.left_m.min(axis=1), views.else_m))
    return (views.seen != BEFORE) & reaches


def directions(left_m: np.ndarray, else_m: np.ndarray) -> np.ndarray:
    """Soft labels by what is left to drive.

    Args:
        left_m: (…, m) from each mark, inf where there is none; else_m: (…) from the best
            frontier without a mark.

    Returns:
        (…, m + 1) float32, sums to 1, or to 0 where nothing leads there; "elsewhere" is the last.
    """
    each = np.concatenate([left_m, else_m[..., None]], -1)
    least = each.min(axis=-1, keepdims=True)
    p = np.exp((np.where(np.isfinite(least), least, 0.0) - each) / SOFT_M)
    return (p / np.maximum(p.sum(axis=-1, keepdims=True), 1e-9)).astype(np.float32)


def scene(views: Views) -> np.ndarray:
    """(n, t) bool: whether the best mark lies near a shortest way from the robot."""
    by_mark_m = (views.path_m[..., None] + views.left_m).min(axis=1)
    shortest_m = np.minimum(views.here_m, np.minimum(by_mark_m, views.else_path_m))
    return by_mark_m <= shortest_m + np.maximum(DETOUR_M, DETOUR_SHARE * shortest_m)
