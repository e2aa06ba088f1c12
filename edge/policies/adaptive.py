"""Policy `adaptive`, as in ApexNav: by the value map if its values differ enough, else by path.

A value map has a score for each cell and target: how promising the cell is.
"""

from __future__ import annotations

import math

import numpy as np

from edge.config import PolicyAdaptive
from edge.jit import jit
from edge.policies.base import PolicyInput, Why
from edge.policies.value_map import count_frontiers, values_near

LEAST_SPREAD = 0.030
"""The values decide only if their standard deviation exceeds this."""
LEAST_RATIO = 1.2
"""The values decide only if their maximum exceeds their mean by this factor."""
MAX_STOPS = 8
"""Largest number of stops in a tour. Of more stops the nearest are used, because the cost of a
tour grows exponentially."""
_FIRST_SCORE, _SCORE_STEP = 2.0, 0.05
"""Score of a tour's first stop, and the decrement for each later stop. Other scores are below 1."""


class AdaptivePolicy:
    """Policy that scores frontiers by nearness, or by their place in a tour of promising frontiers.

    Nearness is by path length. It decides if the values differ too little, or if fewer than two
    reachable frontiers have a value.
    """

    def __init__(self, config: PolicyAdaptive) -> None:
        self.config = config
        self._allocate(0)
        shortest_tour(np.ones(2), np.ones((2, 2), np.float32))  # compile the kernel now

    def score(self, context: PolicyInput) -> np.ndarray:
        """See `Policy.score`."""
        candidates = context.candidates
        n = count_frontiers(candidates)  # frontiers come first in the arrays
        if len(self._score) < len(candidates.kind):
            self._allocate(len(candidates.kind))
        score, value, path_m = self._score, self._value, candidates.path_m[:n]
        score[:n] = 1.0 / (1.0 + path_m)
        score[n : candidates.n] = candidates.confidence[n : candidates.n]
        self._write_values(context, n)
        pose, xy_m = context.pose, candidates.xy_m
        away_m = np.hypot(xy_m[:n, 0] - pose.x_m, xy_m[:n, 1] - pose.y_m)
        reachable = np.isfinite(path_m) & ~candidates.blocked[:n]
        reachable &= away_m > self.config.delta_reached_m
        stops = self._promising_frontiers(np.flatnonzero(reachable & ~np.isnan(value[:n])))
        if len(stops) > 0:
            stops = stops[np.argsort(path_m[stops], kind="stable")][:MAX_STOPS]
            order = shortest_tour(path_m[stops].astype(np.float64), xy_m[stops])
            score[stops[order]] = _FIRST_SCORE - _SCORE_STEP * np.arange(len(stops))
        return score

    def reset(self, why: Why) -> None:
        """Do nothing: this policy has no memory. The value maps belong to the map."""

    def _write_values(self, context: PolicyInput, n: int) -> None:
        """Write the values of the first n candidates; NaN if there is no value.

        A likelihood ratio L becomes L / (1 + L), the posterior probability from even prior odds. It
        then is between 0 and 1, like the values of the value maps.
        """
        value = self._value
        if self.config.by != "prior":
            values_near(context, n, self.config.radius_m, value)
        elif context.prior is None:
            value[:n] = np.nan
        else:
            context.prior.likelihood_ratio(context.target, context.candidates.xy_m, n, value)
            value[:n] /= 1.0 + value[:n]

    def _promising_frontiers(self, scored: np.ndarray) -> np.ndarray:
        """Return the frontiers for the tour, of those with a value; none if nearness decides.

        `scored` and the result are (k,) int64 indices of candidates.
        """
        config, value = self.config, self._value[scored]
        if len(scored) < 2 or value.std() <= LEAST_SPREAD:
            return scored[:0]
        if value.max() <= LEAST_RATIO * value.mean():
            return scored[:0]
        return scored[value >= config.keep * value.max()]

    def _allocate(self, capacity: int) -> None:
        self._score, self._value = (np.zeros(capacity, np.float32) for _ in range(2))


@jit
def shortest_tour(path_m, xy_m):
    """Return the order of the shortest open tour from the robot through all stops (exact).

    The distance between two stops is estimated by a lower bound: the straight line, or the
    difference of their path lengths from the robot, whichever is longer.

    Args:
        path_m: (k,) float64, path length from the robot to each stop; k is at most `MAX_STOPS`.
        xy_m: (k, 2) positions of the stops.

    Returns:
        (k,) int64 indices. Of equally short tours, the one that begins with the lowest index.
    """
    k = len(path_m)
    full = 1 << k
    between_m = np.zeros((k, k))
    for i in range(k):
        for j in range(k):
            straight = math.hypot(xy_m[i, 0] - xy_m[j, 0], xy_m[i, 1] - xy_m[j, 1])
            between_m[i, j] = max(straight, abs(path_m[i] - path_m[j]))
    # `stops` is a bit set: bit i for stop i. cost[stops, i] is the length of the shortest path that
    # begins at stop i and visits all of `stops`; after[stops, i] is its second stop. The tour is
    # built from its end (Held-Karp).
    cost, after = np.full((full, k), np.inf), np.zeros((full, k), np.int64)
    for i in range(k):
        cost[1 << i, i] = 0.0
    for stops in range(1, full):
        for i in range(k):
            if not stops >> i & 1:
                continue
            rest = stops & ~(1 << i)
            for j in range(k):
                if not rest >> j & 1:
                    continue
                total = between_m[i, j] + cost[rest, j]
                if total < cost[stops, i]:
                    cost[stops, i], after[stops, i] = total, j
    order = np.zeros(k, np.int64)
    stop = 0
    for i in range(k):
        if path_m[i] + cost[full - 1, i] < path_m[stop] + cost[full - 1, stop]:
            stop = i
    stops = full - 1
    for place in range(k):
        order[place] = stop
        next_stop = after[stops, stop]
        stops &= ~(1 << stop)
        stop = next_stop
    return order
