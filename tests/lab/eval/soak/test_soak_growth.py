"""Theil and Sen's slope over a process's lives, and its interval."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.soak.growth import slope_of
from edge.lab.eval.soak.rules import GROWTHS, growth_problem, growth_slope

MEMORY = GROWTHS[0]


def life(n: int, per_h: float, noise: float = 0.0, begin: float = 500.0, seed: int = 0):
    t_s = np.arange(float(n))
    chance = np.random.default_rng(seed).standard_normal(n)
    return t_s, begin + per_h * t_s / 3600.0 + noise * chance


@given(st.floats(-1e3, 1e3), st.integers(20, 2000))
def test_the_slope_of_a_line_is_exact(per_h, n):
    slope = slope_of([life(n, per_h)])
    assert slope.per_h == pytest.approx(per_h, abs=1e-4)
    assert slope.low <= slope.high


def test_the_slope_interval_holds_the_truth_and_narrows():
    found = [slope_of([life(n, 30.0, noise=2.0)]) for n in (300, 7200)]
    assert all(slope.low <= 30.0 <= slope.high for slope in found)
    few, many = (slope.high - slope.low for slope in found)
    assert many < 0.1 * few


def test_outliers_do_not_change_the_slope():
    t_s, values = life(1200, 0.0, noise=0.1)
    values[::5] += 1e6
    assert abs(slope_of([(t_s, values)]).per_h) < 1.0


def test_a_new_process_is_another_life_and_no_growth():
    lives = [life(600, 0.0, begin=100.0), life(600, 0.0, begin=900.0)]
    lives[1] = (lives[1][0] + 600.0, lives[1][1])
    assert slope_of(lives).per_h == 0.0


def samples(values, pid=1, calm=True):
    return [
        {"t_s": float(t), "calm": calm, "service": {"pid": pid, "memory_mb": float(mb)}}
        for t, mb in enumerate(values)
    ]


@pytest.mark.parametrize(
    ("per_h", "noise", "ran_h", "broken"),
    [
        (0.0, 0.1, 10.0, False),
        (19.0, 0.0, 10.0, False),
        (60.0, 0.1, 10.0, True),
        (60.0, 400.0, 10.0, False),
        (60.0, 0.1, 0.5, False),
        (300.0, 0.1, 0.5, True),
    ],
    ids=["still", "within", "grows", "nobody can tell", "settles", "more than settles"],
)
def test_significant_growth_breaks_the_rule(per_h, noise, ran_h, broken):
    _, values = life(1800, per_h, noise)
    why = growth_problem(MEMORY, growth_slope(MEMORY, samples(values)), 3600.0 * ran_h)
    assert bool(why) == broken, why


def test_startup_and_faults_do_not_count_as_growth():
    """Memory that rises only at the start and during faults does not grow."""
    found = samples([*np.linspace(0, 500, 100), *[500.0] * 900])
    found[400:500] = samples([9e9] * 100, calm=False)
    slope = growth_slope(MEMORY, found)
    assert slope.high == 0.0
    assert growth_slope(MEMORY, []) is None


def test_an_absent_process_has_no_growth():
    found = samples([1.0] * 200)
    assert growth_slope(GROWTHS[1], [{**sample, "model": None} for sample in found]) is None
