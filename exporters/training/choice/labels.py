"""Labels for training and evaluation: the directions of a view that lead to a target, if any does.

A direction is a mark or "elsewhere", which stands for all frontiers without a mark.
Shapes: n views, m marks, t kinds of object.
"""

from __future__ import annotations

import numpy as np

from edge.perception.runtime.card_types import MARK_FIELDS
from edge.perception.scoring.choice.mark_scorer import FAR_M
from edge.perception.scoring.choice.question import MAX_MARKS
from exporters.training.choice.collect import BEFORE, HW, Views

SOFT_M = 1.5
"""The label of a direction falls by a factor of e for each such length above the best one."""
DETOUR_M = 1.5
"""A path is near the shortest path if it is longer by at most this."""
DETOUR_SHARE = 0.25
"""A path is also near the shortest path if it is longer by at most this share of it."""
CORRECT_WITHIN_M = 0.5
"""A mark is correct if its remaining distance exceeds the shortest one by at most this."""


def marks_of(views: Views) -> np.ndarray:
    """Return the marks in the form of `MarksCard`: (n, MAX_MARKS, MARK_FIELDS) float32.

    The fields are u, v (shares of the image), bearing [rad], distance [m], path [m] (at most
    `FAR_M`), gain [m²], and 1; all are 0 for a mark that does not exist.
    """
    out = np.zeros((len(views), MAX_MARKS, MARK_FIELDS), np.float32)
    out[..., 0] = (views.marks[..., 0] + 0.5) / HW[1]
    out[..., 1] = (views.marks[..., 1] + 0.5) / HW[0]
    out[..., 2:4] = views.marks[..., 2:]
    out[..., 4] = np.minimum(views.path_m, FAR_M)
    out[..., 5], out[..., -1] = views.gain_m2, is_mark(views)
    return out * out[..., -1:]  # zeros for missing marks


def is_mark(views: Views) -> np.ndarray:
    """Return (n, MAX_MARKS) bool, True for an existing mark."""
    return np.arange(MAX_MARKS) < views.count[:, None]


def is_asked(views: Views) -> np.ndarray:
    """Return (n, t) bool: True if the target is reachable and was not seen before this view."""
    is_reachable = np.isfinite(np.minimum(views.left_m.min(axis=1), views.else_m))
    return (views.seen != BEFORE) & is_reachable


def directions(left_m: np.ndarray, else_m: np.ndarray) -> np.ndarray:
    """Return soft labels of the directions: the shorter the remaining way, the higher.

    The remaining distance is `left_m` (…, m) from each mark, and `else_m` (…) from the best
    frontier without a mark; inf if no path leads to the target.

    Returns:
        (…, m + 1) float32 with a sum of 1, or 0 if nothing leads to the target; the last is
        "elsewhere".
    """
    each = np.concatenate([left_m, else_m[..., None]], -1)
    least = each.min(axis=-1, keepdims=True)
    p = np.exp((np.where(np.isfinite(least), least, 0.0) - each) / SOFT_M)
    return (p / np.maximum(p.sum(axis=-1, keepdims=True), 1e-9)).astype(np.float32)


def scene(views: Views) -> np.ndarray:
    """Return (n, t) bool: True if the best mark is near a shortest path from the robot."""
    by_mark_m = (views.path_m[..., None] + views.left_m).min(axis=1)
    shortest_m = np.minimum(views.here_m, np.minimum(by_mark_m, views.else_path_m))
    return by_mark_m <= shortest_m + np.maximum(DETOUR_M, DETOUR_SHARE * shortest_m)
