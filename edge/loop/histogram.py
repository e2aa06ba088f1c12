"""Histograms of durations: exact counts by bucket since the start."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

STAGE_BOUNDS_S = (
    1e-4, 2e-4, 3e-4, 5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3,
    0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0,
)  # fmt: skip
"""Upper bounds of the buckets for durations of stages. They are close together near the budgets
and near the period of a camera."""
INTERVAL_BOUNDS_S = (5e-3, 0.01, 0.02, 0.03, 0.035, 0.04, 0.05, 0.07, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the buckets for intervals between ticks."""


class Histogram(NamedTuple):
    """A histogram of durations.

    Attributes:
        bounds_s: Upper bounds of the buckets, ascending. One more bucket has no bound.
        counts: Number of durations in each bucket, not cumulative.
    """

    bounds_s: tuple[float, ...]
    counts: tuple[int, ...]
    sum_s: float


class Histograms:
    """Histograms with the same buckets, one for each column of a row of durations.

    They use lists and `bisect`, which are twice as fast as NumPy for the ten numbers of a tick.
    """

    def __init__(self, columns: int, bounds_s: Sequence[float]) -> None:
        self._bounds_s = tuple(bounds_s)
        self._bounds_ns = [round(bound * 1e9) for bound in bounds_s]
        self._counts = [[0] * (len(bounds_s) + 1) for _ in range(columns)]
        self._sum_ns = [0] * columns

    def add(self, durations_ns: Sequence[int]) -> None:
        """Count one duration for each column. A negative value means that there was none."""
        for column, duration_ns in enumerate(durations_ns):
            if duration_ns >= 0:
                self.add_one(column, duration_ns)

    def add_one(self, column: int, duration_ns: int) -> None:
        """Count one duration, not negative, in one column."""
        self._counts[column][bisect_left(self._bounds_ns, duration_ns)] += 1
        self._sum_ns[column] += duration_ns

    def read(self) -> list[Histogram]:
        """Return the current histograms, by column."""
        return [
            Histogram(self._bounds_s, tuple(counts), sum_ns * 1e-9)
            for counts, sum_ns in zip(self._counts, self._sum_ns, strict=True)
        ]
