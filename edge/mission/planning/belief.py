"""Where what is looked for may be, and how far a search for it is expected to lead.

A target is behind a frontier with a chance that goes by the unknown area there and by the prior's
lift, or farther on, where no frontier shows it yet. A search goes from frontier to frontier as the
policy `search` does, and looks for everything on its way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from edge.geometry import SE2, Grid
from edge.mission.planning.distances import distances

BEYOND_M2 = 20.0
"""Unknown area that no frontier shows yet, such as the rooms behind those behind the frontiers."""
START_M = 1.0
"""As `policy.start_m` of `search`: no frontier is so near that it is worth any area."""
SIGHT_M = 2.0
"""What is left to drive to an object when a search shows it."""
MOST_PROSPECTS = 64
"""Frontiers that are reckoned with, the largest: a tour takes the square of their number."""


class Prospects(NamedTuple):
    """Where a search may go on: frontiers, and a turn on the spot.

    Attributes:
        xy_m: (n, 2) float64 in `map`.
        area_m2: (n,) float64, unknown area that each would show, over 0.
        lift: (k, n) float64, how much likelier than elsewhere each target is there
            (`edge.policies.base.Prior.lift`), over 0.
    """

    xy_m: np.ndarray
    area_m2: np.ndarray
    lift: np.ndarray

    def largest(self) -> Prospects:
        """At most `MOST_PROSPECTS` of them."""
        if len(self.area_m2) <= MOST_PROSPECTS:
            return self
        kept = np.sort(np.argsort(-self.area_m2, kind="stable")[:MOST_PROSPECTS])
        return Prospects(self.xy_m[kept], self.area_m2[kept], self.lift[:, kept])


class Survey(NamedTuple):
    """What was worked out of the map beside the loop; see `Knowledge` for both.

    Attributes:
        distance_m: (k + 1, k) float64.
        search_m: (k + 1, k, k) float64; None: nobody goes by it.
    """

    distance_m: np.ndarray
    search_m: np.ndarray | None = None


def survey(
    snapshot: Grid,
    pose: SE2,
    positions: Sequence[np.ndarray],
    prospects: Prospects,
    explore_m: float,
) -> Survey:
    """Driving distances, and what a search from each object and from the robot is expected to take.

    Args:
        positions: see `distances`.
        explore_m: how much farther what no frontier shows is than the frontiers.
    """
    k, prospects = len(positions), prospects.largest()
    ends = [*positions, *prospects.xy_m[:, None, :]]
    out = distances(snapshot, (pose.x_m, pose.y_m), ends, begin=k)
    sought = np.array([len(position) == 0 for position in positions], bool)
    return expected_searches(out[:, :k], out[:, k:], prospects, sought, explore_m)


def expected_searches(
    distance_m: np.ndarray,
    way_m: np.ndarray,
    prospects: Prospects,
    sought: np.ndarray,
    explore_m: float,
) -> Survey:
    """What is expected of objects of which no instance is known.

    P(target behind frontier i) = area_i lift_i / (sum over all frontiers + `BEYOND_M2`), and what
    no frontier shows lies beyond them, as often beyond each as behind it. From one frontier to
    another it is as far as the crow flies, and no less than what distances from any third place
    say: the bound of ALT (Goldberg and Harrelson, SODA 2005), with objects and the robot as
    landmarks.

    Args:
        distance_m: (k + 1, k) float64, between objects; see `distances`.
        way_m: (k + 1, n) float64, from each object and from the robot to each frontier.
        sought: (k,) bool, objects of which no instance is known.

    Returns:
        Distances in which an object that is sought has the mean of those to where it may be.
    """
    k = len(sought)
    distance_m, there = distance_m.copy(), np.isfinite(way_m[-1])
    search_m = np.full((k + 1, k, k), explore_m)
    if not there.any():
        return Survey(distance_m, search_m)
    way_m, lift = way_m[:, there], prospects.lift[:, there]
    xy_m, area_m2 = prospects.xy_m[there], prospects.area_m2[there]
    # What is no landmark, for want of a free cell beside it, is taken to be where the robot is.
    way_m = np.where(np.isfinite(way_m), way_m, way_m[-1])
    between_m = np.hypot(*np.moveaxis(xy_m[:, None] - xy_m, -1, 0))
    for row in way_m:
        np.maximum(between_m, np.abs(row[:, None] - row), out=between_m)
    shown = area_m2 * lift
    behind = shown / shown.sum(axis=1, keepdims=True)
    beyond_m = explore_m * BEYOND_M2 / (shown.sum(axis=1) + BEYOND_M2)
    way_m[:-1][sought] = behind[sought] @ between_m
    expected_m = way_m @ behind.T + beyond_m
    distance_m[:, sought] = expected_m[:, sought]
    objects_m = distance_m[:-1]
    objects_m[np.ix_(sought, ~sought)] = expected_m[:-1][np.ix_(~sought, sought)].T
    objects_m[sought, sought] = SIGHT_M
    tours(way_m, between_m, np.sqrt(area_m2) * lift, behind, search_m)
    return Survey(distance_m, search_m + beyond_m)


@njit(nogil=True, cache=True)
def tours(way_m, between_m, worth, behind, out):
    """Mean metres until an object is come by that is behind one of the frontiers.

    From each place and for each target, the tour that goes on to the frontier with the most worth
    over the way there and `START_M`: the policy `search`'s order.

    Args:
        way_m: (places, n) float64, from each place to each frontier.
        between_m: (n, n) float64, from frontier to frontier.
        worth: (k, n) float64, over 0, of each frontier to the search for each target.
        behind: (k, n) float64, P(object behind the frontier | behind one of them).
        out: (places, k, k) float64, written: from a place, for a target, until each object.
    """
    k, n = worth.shape
    left = np.empty(n, np.bool_)
    out[:] = 0.0
    for p in range(way_m.shape[0]):
        for target in range(k):
            left[:] = True
            walked_m, at = 0.0, way_m[p]
            for _ in range(n):
                best, most = -1, -1.0
                for i in range(n):
                    score = worth[target, i] / (START_M + at[i])
                    if left[i] and score > most:
                        best, most = i, score
                walked_m += at[best]
                left[best], at = False, between_m[best]
                for j in range(k):
                    out[p, target, j] += behind[j, best] * walked_m


def warm_up() -> None:
    """Compile the kernel, or read it from the cache."""
    one = np.ones((1, 1))
    prospects = Prospects(np.zeros((1, 2)), np.ones(1), one)
    expected_searches(np.full((2, 1), np.inf), np.ones((2, 1)), prospects, one[0] > 0, 10.0)
