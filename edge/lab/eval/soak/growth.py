"""Whether something grows: a slope that no outlier moves, and how well it is known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_BINS = 240
_FEWEST = 8
_Z95 = 1.96


class Slope(NamedTuple):
    """What it grows by an hour, and the bounds of its 95 % interval."""

    per_h: float
    low: float
    high: float

    @property
    def resolves(self) -> float:
        """The smallest growth that would have shown."""
        return 0.5 * (self.high - self.low)


def slope_of(lives: Iterable[tuple[np.ndarray, np.ndarray]]) -> Slope | None:
    """Theil and Sen's slope, with Sen's interval from the variance of Kendall's S.

    Samples of a second are much alike, which the interval would take for knowledge: what is
    compared are medians over longer times, of which there are at most `_BINS`. Only values within
    one life of a process are compared.

    Args:
        lives: (n,) seconds and (n,) values of each, in order of time.

    Returns:
        None where there is too little to tell.
    """
    thinned = [_thin(*life) for life in _sized(lives)]
    slopes, variance = [np.zeros(0)], 0.0
    for t_s, values in thinned:
        i, j = np.triu_indices(len(t_s), 1)
        slopes.append((values[j] - values[i]) / (t_s[j] - t_s[i]) * 3600.0)
        n = len(t_s)
        variance += n * (n - 1) * (2 * n + 5) / 18.0
    every = np.sort(np.concatenate(slopes))
    if sum(len(t_s) for t_s, _ in thinned) < _FEWEST:
        return None
    half = _Z95 * math.sqrt(variance)
    n = len(every)
    low, high = (n - half) / 2.0 - 1.0, (n + half) / 2.0
    bounds = np.clip([math.floor(low), math.ceil(high)], 0, n - 1)
    return Slope(float(np.median(every)), *(float(every[k]) for k in bounds))


def _sized(
    lives: Iterable[tuple[np.ndarray, np.ndarray]],
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Each life with the length of its bins, the same for all."""
    kept = [(t_s, values) for t_s, values in lives if len(t_s) > 1]
    whole_s = sum(float(t_s[-1] - t_s[0]) for t_s, _ in kept)
    return [(t_s, values, max(whole_s / _BINS, 1e-9)) for t_s, values in kept]


def _thin(t_s: np.ndarray, values: np.ndarray, bin_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Medians over bins of this length, those with nothing in them left out."""
    bins = ((t_s - t_s[0]) / bin_s).astype(np.int64)
    parts = np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(bins)) + 1)
    medians = [(np.median(t_s[part]), np.median(values[part])) for part in parts]
    return tuple(np.array(medians, np.float64).T)  # type: ignore[return-value]
