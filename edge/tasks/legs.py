"""Legs of a coarse trajectory: parts for which A* runs one after the other.

`edge.tasks.refine` uses them. The *tube* is the strip around the coarse trajectory that A* prefers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.errors import UserError
from edge.trajectory.speeds import headings_rad

TURN_RAD = math.radians(45.0)
"""A segment is cut where it has turned by this angle, so that A* cannot shorten a longer bend.

A circle as wide as three tubes becomes an octagon whose sides are inside the tube.
"""
_COS_TURN = math.cos(TURN_RAD) + 1e-6


class RefineError(UserError):
    """No trajectory can be driven; the message gives the place and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A part of the coarse trajectory for which A* runs once.

    Attributes:
        points_m: (n, 2) float64 in `map`, n >= 1, without the end point of the leg before.
        ends_segment: True if its end must be reached; otherwise the end only keeps A* from
            shortening a bend.
    """

    points_m: np.ndarray
    ends_segment: bool


def cut_into_legs(
    segments: Sequence[np.ndarray], start_xy_m: tuple[float, float], tube_m: float
) -> tuple[Leg, ...]:
    """Split the coarse trajectory into legs: its segments, cut where they turn by `TURN_RAD`.

    Args:
        segments: (n, 2) points each, n >= 1, as `trajectory.coarse_of` makes them.
        start_xy_m: place of the robot.
        tube_m: deviations from a straight line of less than half of this are not turns.
    """
    legs: list[Leg] = []
    last = np.array(start_xy_m)
    for points in segments:
        # Index k of the polyline with `last` in front is the end of `points[:k]`.
        bends = _bends(np.concatenate([last[None], points]), 0.5 * tube_m)
        for part in np.split(points, bends):
            legs.append(Leg(part, ends_segment=False))
        legs[-1] = Leg(legs[-1].points_m, ends_segment=True)
        last = points[-1]
    return tuple(legs)


def _bends(points_m: np.ndarray, tolerance_m: float) -> list[int]:
    """Return the indices of the points where a polyline has turned by `TURN_RAD` once more.

    Turns are counted from the start, or from the bend before. No index is 0.
    """
    rough = simplified(points_m, tolerance_m)
    headings = headings_rad(points_m[rough])[:-1]
    found, first = list[int](), headings[0] if len(headings) else 0.0
    for k in range(1, len(headings)):
        if math.cos(headings[k] - first) <= _COS_TURN:
            found.append(rough[k])
            first = headings[k]
    return found


def simplified(points_m: np.ndarray, tolerance_m: float) -> list[int]:
    """Return the indices of the points that a polyline needs (Douglas & Peucker 1973).

    OpenCV's version reduces a closed polyline to one point.
    """
    kept, spans = {0, len(points_m) - 1}, [(0, len(points_m) - 1)]
    while spans:
        first, last = spans.pop()
        along = points_m[last] - points_m[first]
        between = points_m[first + 1 : last] - points_m[first]
        share = np.clip(between @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        away = np.hypot(*(between - share[:, None] * along).T)
        if len(away) and away.max() > tolerance_m:
            farthest = first + 1 + int(np.argmax(away))
            kept.add(farthest)
            spans += [(first, farthest), (farthest, last)]
    return sorted(kept)
