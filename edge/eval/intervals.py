"""Confidence intervals at 95 %."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

Z = 1.959963984540054


class Interval(NamedTuple):
    """An estimate and its bounds; NaN where nothing was measured."""

    value: float
    low: float
    high: float


def wilson(successes: int, n: int) -> Interval:
    """A share, with Wilson's score interval (1927), which stays within [0, 1].

    >>> [round(x, 3) for x in wilson(95, 100)]
    [0.95, 0.888, 0.978]
    """
    if n == 0:
        return Interval(math.nan, math.nan, math.nan)
    share, z2 = successes / n, Z * Z
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = Z * math.sqrt(share * (1 - share) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return Interval(share, max(0.0, min(middle - half, share)), min(1.0, max(middle + half, share)))


def ratio(numerators: np.ndarray, denominators: np.ndarray) -> Interval:
    """A ratio of sums over independent pairs, its interval by the delta method.

    Args:
        numerators, denominators: (n,), one pair a task. Pairing matters: what a task's
            difficulty does to both cancels out.
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
