"""Confidence intervals: published values, limits, and coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.intervals import bootstrap, ratio, wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),  # Newcombe (1998), table I gives such values
        (10, 10, 0.7225, 1.0),
        (81, 263, 0.2553, 0.3662),  # Newcombe (1998), method 3
        (15, 148, 0.0624, 0.1605),
    ],
)
def test_wilson(successes, n, low, high):
    interval = wilson(successes, n)
    assert interval.value == successes / n
    assert interval[1:] == pytest.approx((low, high), abs=1e-4)


@given(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_holds_its_share_and_stays_a_share(pair):
    value, low, high = wilson(*pair)
    assert 0.0 <= low <= value <= high <= 1.0


def test_nothing_measured():
    empty = np.zeros(0)
    for interval in (wilson(0, 0), ratio(empty, empty), ratio(np.ones(3), np.zeros(3))):
        assert all(math.isnan(x) for x in interval)


def test_one_measurement_has_no_interval():
    value, low, high = ratio(np.array([3.0]), np.ones(1))
    assert value == 3.0
    assert math.isnan(low)
    assert math.isnan(high)


def test_ratio_covers_the_truth_19_times_in_20():
    rng, inside = np.random.default_rng(0), 0
    for _ in range(1000):
        y = rng.exponential(2.0, 200)
        x = 1.5 * y + rng.normal(0, 1, 200)
        _, low, high = ratio(x, y)
        inside += low <= 1.5 <= high
    assert 925 <= inside <= 970


# -- bootstrap over clusters --------------------------------------------------------------------


def means(values: np.ndarray, cluster: np.ndarray, **options):
    """Return the intervals of the means of (k, n) values without gaps."""
    return bootstrap(values, np.ones_like(values), cluster, **options)


def test_bootstrap_is_seeded_and_agrees_with_the_ratio():
    rng = np.random.default_rng(0)
    x, y = rng.exponential(2.0, (2, 400))
    one, other = (bootstrap(x[None], y[None], np.arange(400), seed=3) for _ in range(2))
    assert one == other
    assert one[0] == pytest.approx(ratio(x, y), rel=0.02)


def test_repeats_within_a_cluster_add_no_confidence():
    each = np.random.default_rng(1).normal(0.0, 1.0, 40)
    (alone,) = means(each[None], np.arange(40))
    (repeated,) = means(np.repeat(each, 25)[None], np.repeat(np.arange(40), 25))
    assert repeated == pytest.approx(alone)
    (as_if_independent,) = means(np.repeat(each, 25)[None], np.arange(1000))
    assert (as_if_independent.high - as_if_independent.low) < 0.3 * (alone.high - alone.low)


@pytest.mark.parametrize(("clusters", "least"), [(10, 0.91), (60, 0.925)])
def test_clustered_intervals_cover_the_truth_19_times_in_20(clusters, least):
    rng, inside, cluster = np.random.default_rng(2), 0, np.repeat(np.arange(clusters), 4)
    for k in range(300):
        values = rng.normal(0.0, 1.0, clusters)[cluster] + rng.normal(0.0, 1.0, 4 * clusters)
        (found,) = means(values[None], cluster, resamples=600, seed=k)
        inside += found.low <= 0.0 <= found.high
    assert least <= inside / 300 <= 0.985


@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_turned_round_a_difference_is_its_negative(seed, n):
    rng = np.random.default_rng(seed)
    values, cluster = rng.normal(size=(1, n)), rng.integers(0, 5, n)
    there, back = (means(sign * values, cluster, resamples=200)[0] for sign in (1.0, -1.0))
    assert (back.value, back.low, back.high) == pytest.approx(
        (-there.value, -there.high, -there.low), nan_ok=True
    )
