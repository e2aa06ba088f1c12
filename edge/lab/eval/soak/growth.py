"""Growth of a value in `edge soak`: a slope that is robust to outliers, with its interval."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

_BINS = 240  # most values to compare
_MIN_VALUES = 8  # with fewer values there is no slope
_Z95 = 1.96  # quantile of the normal distribution for 95 %


class Slope(NamedTuple):
    """Growth in an hour, in the value's unit, with the bounds of its 95 % interval."""

    per_h: float
    low: float
    high: float


def slope_of(lives: Iterable[tuple[np.ndarray, np.ndarray]]) -> Slope | None:
    """Return the Theil-Sen slope: the median of the slopes between any two values.

    A life of a process is (n,) seconds and (n,) values, in order of time. Values are compared only
    within one life. Too few values have no slope.

    The interval is Sen's: two ranks of the sorted slopes, from the variance of Kendall's S.

    Samples of adjacent seconds are correlated, which would make the interval too narrow. So medians
    over longer bins are compared, at most about `_BINS`.
    """
    thinned = [_bin_medians(*life) for life in _with_bin_length(lives)]
    slopes, variance = [np.zeros(0)], 0.0
    for t_s, values in thinned:
        i, j = np.triu_indices(len(t_s), 1)
        slopes.append((values[j] - values[i]) / (t_s[j] - t_s[i]) * 3600.0)
        n = len(t_s)
        variance += n * (n - 1) * (2 * n + 5) / 18.0  # of Kendall's S, for values without ties
    sorted_slopes = np.sort(np.concatenate(slopes))
    if sum(len(t_s) for t_s, _ in thinned) < _MIN_VALUES:
        return None
    width = _Z95 * math.sqrt(variance)  # of the interval, in ranks of slopes
    n = len(sorted_slopes)
    low, high = (n - width) / 2.0 - 1.0, (n + width) / 2.0
    bounds = np.clip([math.floor(low), math.ceil(high)], 0, n - 1)
    return Slope(float(np.median(sorted_slopes)), *(float(sorted_slopes[k]) for k in bounds))


def _with_bin_length(
    lives: Iterable[tuple[np.ndarray, np.ndarray]],
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return each life of at least two samples, with the bin length, which is the same for all."""
    kept = [(t_s, values) for t_s, values in lives if len(t_s) > 1]
    total_s = sum(float(t_s[-1] - t_s[0]) for t_s, _ in kept)
    return [(t_s, values, max(total_s / _BINS, 1e-9)) for t_s, values in kept]


def _bin_medians(
    t_s: np.ndarray, values: np.ndarray, bin_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return medians over bins of this length, without empty bins."""
    bins = ((t_s - t_s[0]) / bin_s).astype(np.int64)
    parts = np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(bins)) + 1)
    medians = [(np.median(t_s[part]), np.median(values[part])) for part in parts]
    return tuple(np.array(medians, np.float64).T)  # type: ignore[return-value]
