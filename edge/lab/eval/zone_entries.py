"""Counts the entries of the robot into keep-out zones, by ground truth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

_STEP_M = 0.01  # distance of the checked points of a path
_TOUCH_M = 1e-3  # a footprint that overlaps a zone by less only touches it


class ZoneEntryCounter:
    """Counter of entries of the robot's footprint, a disc, into keep-out zones: (n, 2) polygons.

    Attributes:
        entries: number of entries so far. A start inside a zone is none.
    """

    def __init__(self, zones_m: Sequence[np.ndarray], radius_m: float) -> None:
        self._zones_m, self._radius_m = zones_m, radius_m
        self._last_m: np.ndarray | None = None
        self._inside = False
        self.entries = 0

    def update(self, x_m: float, y_m: float) -> None:
        """Add the way from the last place to this one, as a straight line."""
        here_m = np.array([x_m, y_m])
        last_m, self._last_m = self._last_m, here_m
        if last_m is None:
            self._inside = self._is_in_zone(here_m[None])[0]
            return
        steps = 1 + int(math.dist(last_m, here_m) / _STEP_M)
        path_m = last_m + np.linspace(0.0, 1.0, steps + 1)[1:, None] * (here_m - last_m)
        for inside in self._is_in_zone(path_m):
            self.entries += inside and not self._inside
            self._inside = inside

    def _is_in_zone(self, xy_m: np.ndarray) -> list[bool]:
        """Return True for each place at which the footprint is in a zone."""
        near_m = np.min([distance_m(zone, xy_m) for zone in self._zones_m], axis=0)
        return (near_m < self._radius_m - _TOUCH_M).tolist()


def distance_m(corners_m: np.ndarray, xy_m: np.ndarray) -> np.ndarray:
    """Return the distance of points (n, 2) from a polygon (k, 2), (n,) float64; 0 inside."""
    after_m = np.roll(corners_m, -1, axis=0)
    inside = np.zeros(len(xy_m), bool)
    nearest = np.full(len(xy_m), np.inf)
    x, y = xy_m.T
    for (ax, ay), (bx, by) in zip(corners_m, after_m, strict=True):
        dx, dy = bx - ax, by - ay
        along = np.clip(((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-12), 0.0, 1.0)
        np.minimum(nearest, np.hypot(x - ax - along * dx, y - ay - along * dy), out=nearest)
        # Even-odd rule: each edge that a ray to the right crosses flips `inside`.
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * dx / dy)
    return np.where(inside, 0.0, nearest)
