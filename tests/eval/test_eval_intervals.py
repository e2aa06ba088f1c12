"""Confidence intervals: published values, limits, and coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.eval.intervals import ratio, wilson


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
    for interval in (
        wilson(0, 0),
        ratio(empty, empty),
        ratio(np.ones(3), np.zeros(3)),
    ):
        assert all(math.isnan(x) for x in interval)


def test_one_measurement_has_no_interval():
    value, low, high = ratio(np.array([3.0]), np.ones(1))
    assert value == 3.0
    assert math.isnan(low)
    assert math.isnan(high)


def test_mean_is_the_textbooks():
    values = np.array([1.0, 2.0, 4.0, 9.0])
    half = 1.959964 * values.std(ddof=1) / 2
    assert ratio(values, np.ones(4)) == pytest.approx((4.0, 4.0 - half, 4.0 + half))


def test_proportional_pairs_have_an_exact_ratio():
    y = np.array([1.0, 5.0, 2.0])
    assert ratio(3 * y, y) == pytest.approx((3.0, 3.0, 3.0))


def test_ratio_covers_the_truth_19_times_in_20():
    rng, inside = np.random.default_rng(0), 0
    for _ in range(1000):
        y = rng.exponential(2.0, 200)
        x = 1.5 * y + rng.normal(0, 1, 200)
        _, low, high = ratio(x, y)
        inside += low <= 1.5 <= high
    assert 925 <= inside <= 970
