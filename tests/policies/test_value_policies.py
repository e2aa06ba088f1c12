"""Policies that use the value maps: their choice of a frontier, and their fallbacks."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_policy_scores import candidates_of

from edge.config import PolicyAdaptive, PolicyDirectional, PolicyVlfm
from edge.policies import make_policy
from edge.policies.adaptive import shortest_tour
from edge.policies.base import FRONTIER, PolicyInput, ScorerOutputs, scores_of
from edge.types import Observation

NOTHING = math.nan


class Valued:
    """A map with values by place, in which the way is straight, or given by place; None: no way."""

    def __init__(self, values=None, path_m=None) -> None:
        self.told, self.paths_m, self.values = values or {}, path_m or {}, self

    def best(self, channel, xy_m, n, radius_m, out) -> None:
        for i in range(n):
            told = self.told.get(tuple(xy_m[i].tolist()), NOTHING)
            out[i] = told[channel] if isinstance(told, tuple) else told

    def path_m(self, x_m: float, y_m: float) -> float:
        path_m = self.paths_m.get((x_m, y_m), math.hypot(x_m, y_m))
        return math.inf if path_m is None else path_m


class Lifts:
    """A prior that knows some places, by target."""

    def __init__(self, lifts) -> None:
        self.lifts = lifts

    def likelihood_ratio(self, target, xy_m, n, out) -> None:
        for i in range(n):
            out[i] = self.lifts.get((target, *xy_m[i].tolist()), 1.0)


def scored(policy, seen: Valued, *entries, targets=("bed",), target="bed", blocked=(), prior=None):
    candidates = candidates_of(*entries)
    candidates.blocked[list(blocked)] = True
    for i in range(candidates.n):
        candidates.path_m[i] = seen.path_m(*candidates.xy_m[i].tolist())
    at = Observation(0, 0, np.eye(4))
    context = PolicyInput(
        at, at.pose, seen, (0, 0, 0, 0), candidates.read_only(), None, ScorerOutputs(), targets,
        target, 0, prior=prior,
    )  # fmt: skip
    return scores_of(make_policy(policy), context).copy()


def first(score: np.ndarray) -> int:
    return int(np.argmax(score))


A, B, C, D = ((FRONTIER, *at) for at in ((2.0, 0.0), (0.0, 5.0), (0.0, -3.0), (-4.0, 0.0)))
a, b, c, d = ((x, y) for _, x, y in (A, B, C, D))
POLICIES = [PolicyVlfm(), PolicyDirectional(), PolicyAdaptive()]


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: p.kind)
def test_without_candidates_nothing_is_scored(policy):
    assert scored(policy, Valued()).size == 0


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: p.kind)
def test_without_values_the_nearest_frontier_wins(policy):
    around = Valued(path_m={a: 9.0})
    score = scored(policy, around, A, B, C, D)
    assert np.argsort(-score).tolist() == [2, 3, 1, 0]
    assert (score > 0).all()


@pytest.mark.parametrize("policy", POLICIES[:2], ids=lambda p: p.kind)
@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({b: 0.3, c: 0.2}, 1),
        ({b: 0.3, c: 0.302}, 2),
        ({b: 0.3, c: 0.3}, 2),  # equals: the nearer
        ({b: 0.1}, 1),  # A, C and D have no value
        ({a: 0.0, b: 0.0, c: 0.0}, 0),
    ],
)
def test_the_frontier_with_the_best_nearby_value_wins(policy, values, expected):
    assert first(scored(policy, Valued(values), A, B, C, D)) == expected


@pytest.mark.parametrize("kind", [PolicyVlfm, PolicyDirectional], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize(("nearness", "expected"), [(1e-3, 1), (0.3, 1), (3.0, 0)])
def test_the_more_nearness_counts_the_nearer_is_taken(kind, nearness, expected):
    seen = Valued({a: 0.1, b: 0.3})  # 2 m and 5 m away
    assert first(scored(kind(nearness=nearness), seen, A, B)) == expected


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        # The best stands out: there, however far.
        ({a: 0.1, b: 0.5, c: 0.1, d: 0.1}, 1),
        # Over 1.2 times the mean, but within a standard deviation of 0.030: geometry.
        ({a: 0.02, b: 0.05, c: 0.02, d: 0.02}, 0),
        # Spread enough, but the best is hardly above the mean.
        ({a: 0.9, b: 1.0, c: 0.9, d: 0.9}, 0),
        # One scored frontier tells nothing apart.
        ({b: 0.9}, 0),
        # Two within 0.9 of the best: the nearer, with the tour going on to the other.
        ({a: 0.1, b: 0.5, c: 0.1, d: 0.46}, 3),
        # Half of the best's value is no stop of the tour.
        ({a: 0.25, b: 0.5, c: 0.0, d: 0.0}, 1),
    ],
)
def test_adaptive_follows_values_that_stand_out(values, expected):
    assert first(scored(PolicyAdaptive(), Valued(values), A, B, C, D)) == expected


@pytest.mark.parametrize(
    ("lifts", "expected"),
    [
        (None, 0),  # no prior
        ({}, 0),  # no opinion
        ({("sofa", *b): 4.0}, 0),  # of something else
        ({("bed", *b): 4.0}, 1),
        ({("bed", *b): 1.2}, 0),
        ({("bed", *b): 3.0, ("bed", *d): 2.9}, 3),
    ],
)
def test_the_prior_can_replace_values(lifts, expected):
    by_prior, prior = PolicyAdaptive(by="prior"), None if lifts is None else Lifts(lifts)
    assert first(scored(by_prior, Valued({c: 0.9}), A, B, C, D, prior=prior)) == expected


def test_the_first_frontier_starts_the_shortest_tour():
    """East lies nearest; west first, and then all of the east, is 2.5 + 8.5 m instead of 14.5."""
    east = [(FRONTIER, x, 0.0) for x in (2.0, 4.0, 6.0)]
    west = (FRONTIER, -2.5, 0.0)
    values = {(x, y): 0.5 for _, x, y in (*east, west)} | {b: 0.0, c: 0.0, d: 0.0}
    score = scored(PolicyAdaptive(), Valued(values), *east, west, B, C, D)
    assert np.argsort(-score)[:4].tolist() == [3, 0, 1, 2]
    values[-2.5, 0.0] = 0.0
    far_first = Valued(values, path_m={(2.0, 0.0): 9.0, (4.0, 0.0): 7.0, (6.0, 0.0): 5.0})
    score = scored(PolicyAdaptive(), far_first, *east, west, B, C, D)
    assert np.argsort(-score)[:3].tolist() == [2, 1, 0]


@given(seed=st.integers(0, 10**6), k=st.integers(1, 6))
def test_shortest_tour_agrees_with_all_permutations(seed, k):
    rng = np.random.default_rng(seed)
    xy_m = rng.uniform(-9, 9, (k, 2)).astype(np.float32)
    path_m = np.hypot(*xy_m.T).astype(np.float64) * rng.uniform(1.0, 3.0, k)

    def length(order) -> float:
        legs = [
            max(math.dist(xy_m[i], xy_m[j]), abs(path_m[i] - path_m[j]))
            for i, j in itertools.pairwise(order)
        ]
        return path_m[order[0]] + sum(legs)

    order = shortest_tour(path_m, xy_m).tolist()
    assert sorted(order) == list(range(k))
    best = min(map(length, itertools.permutations(range(k))))
    assert length(order) == pytest.approx(best, rel=1e-5)
