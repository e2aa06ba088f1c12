"""Confidence intervals at 95 % of the figures of an evaluation.

Wilson's interval and Student's quantiles come from SciPy. SciPy's bootstrap cannot resample
clusters of ratios, so the bootstrap is here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, stdtrit

Z = 1.959963984540054  # quantile of the normal distribution for 95 %
RESAMPLES = 10_000  # of the bootstrap
MIN_WORLDS = 10  # that are resampled
_CHUNK = 500  # resamples at a time, which limits the memory of their weights


class Interval(NamedTuple):
    """An estimate and its bounds; NaN if nothing was measured."""

    value: float
    low: float
    high: float


def wilson(successes: int, n: int) -> Interval:
    """Return a share with Wilson's score interval (1927), which stays within [0, 1].

    >>> [round(x, 3) for x in wilson(95, 100)]
    [0.95, 0.888, 0.978]
    """
    if n == 0:
        return Interval(math.nan, math.nan, math.nan)
    from scipy.stats import binomtest  # takes a second to import

    bounds = binomtest(successes, n).proportion_ci(method="wilson")
    return Interval(successes / n, float(bounds.low), float(bounds.high))


def clusters(worlds: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the clusters of episodes that the bootstrap resamples, by the world of each episode.

    They are the worlds, as the episodes of one world are not independent. With fewer than
    `MIN_WORLDS`, episodes are resampled. Such intervals do not generalise to other worlds.

    Returns:
        (n,) int, the cluster of each episode; and True if the clusters are worlds.
    """
    names, index = np.unique(worlds, return_inverse=True)
    if len(names) >= MIN_WORLDS:
        return index.ravel(), True
    return np.arange(len(worlds)), False


def intervals_note(worlds: np.ndarray, noun: str = "world") -> str:
    """Return a sentence that explains the intervals of a table; `worlds` as of `clusters`."""
    n, by_world = len(set(worlds.tolist())), clusters(worlds)[1]
    how = f"{n} {noun}s" if by_world else (
        f"episodes of {n} {noun}{'s' * (n != 1)}; they do not generalise to other {noun}s"
    )  # fmt: skip
    return f"In brackets: 95 % intervals, Wilson's for shares, else by bootstrap over {how}."


def ratio(numerators: np.ndarray, denominators: np.ndarray) -> Interval:
    """Return a ratio of sums over independent pairs, with its interval by the delta method.

    Both arrays have one value per task, (n,). Pairing matters: the effect of a task's difficulty on
    both cancels out.
    """
    n = len(numerators)
    if n == 0 or denominators.sum() == 0:
        return Interval(math.nan, math.nan, math.nan)
    value = float(numerators.sum() / denominators.sum())
    if n == 1:
        return Interval(value, math.nan, math.nan)
    residuals = numerators - value * denominators
    half = Z * float(residuals.std(ddof=1)) / math.sqrt(n) / abs(float(denominators.mean()))
    return Interval(value, value - half, value + half)


def bootstrap(
    numerators: np.ndarray,
    denominators: np.ndarray,
    cluster: np.ndarray,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> list[Interval]:
    """Return k ratios of sums over clustered data, with intervals from resampled clusters.

    Numerators and denominators are (k, n) float64, one row per ratio. An entry outside a row's
    ratio is 0 in both. `cluster`, (n,) int, is the same number for entries that are not
    independent. For a mean, the numerators are the values and the denominators are 1. For a paired
    difference, the numerators are the differences.

    The quantiles are those of the expanded percentile interval (Hesterberg 2015, "What teachers
    should know about the bootstrap"), which is not too narrow for a few clusters. All rows use the
    same resamples. The bounds are NaN with fewer than two clusters; all is NaN if the denominators
    sum to 0.
    """
    k = len(numerators)
    numbers, index = np.unique(cluster, return_inverse=True)
    sums = np.zeros((len(numbers), 2 * k))
    np.add.at(sums, index.ravel(), np.concatenate([numerators, denominators]).T)
    counted = np.zeros((len(numbers), k), bool)
    np.logical_or.at(counted, index.ravel(), ((numerators != 0) | (denominators != 0)).T)
    totals = sums.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = totals[:k] / totals[k:]
        draws = _resampled_ratios(sums, k, resamples, seed)
    return [
        _expanded_percentiles(*row)
        for row in zip(values, draws.T, counted.sum(axis=0), strict=True)
    ]


def _resampled_ratios(sums: np.ndarray, k: int, resamples: int, seed: int) -> np.ndarray:
    """Return (resamples, k) ratios of sums over clusters that are drawn with replacement."""
    rng, clusters = np.random.default_rng(seed), len(sums)
    draws = np.empty((resamples, k))
    for first in range(0, resamples if clusters else 0, _CHUNK):
        m = min(_CHUNK, resamples - first)
        # One `bincount` counts for all m resamples: resample i has the numbers from i * clusters.
        picks = rng.integers(0, clusters, (m, clusters)) + clusters * np.arange(m)[:, None]
        weights = np.bincount(picks.ravel(), minlength=m * clusters).reshape(m, clusters)
        drawn = weights.astype(np.float64) @ sums
        draws[first : first + m] = drawn[:, :k] / drawn[:, k:]
    return draws


def _expanded_percentiles(value: float, draws: np.ndarray, clusters: int) -> Interval:
    """Return a value with the bounds from its resampled values, widened for few clusters."""
    value = float(value)
    draws = draws[np.isfinite(draws)] if clusters > 1 else draws[:0]
    if not math.isfinite(value) or not len(draws):
        return Interval(value if math.isfinite(value) else math.nan, math.nan, math.nan)
    # Student's quantile, widened as in Hesterberg 2015, gives the percentiles to take.
    t = stdtrit(clusters - 1, 0.975) * math.sqrt(clusters / (clusters - 1))
    low, high = np.quantile(draws, (ndtr(-t), ndtr(t)))
    return Interval(value, float(low), float(high))
