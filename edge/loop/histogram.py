"""How many durations were how long: counts by bucket, exact since the start."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

# Close together where budgets lie, and around a camera's period.
SPANS_S = (
    1e-4, 2e-4, 3e-4, 5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3,
    0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0,
)  # fmt: skip
INTERVALS_S = (5e-3, 0.01, 0.02, 0.03, 0.035, 0.04, 0.05, 0.07, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class Histogram(NamedTuple):
    """One distribution.

    Attributes:
        bounds_s: the longest that a bucket holds, rising; one more bucket holds all else.
        counts: by bucket, each for itself.
        sum_s: of all that was counted.
    """

    bounds_s: tuple[float, ...]
    counts: tuple[int, ...]
    sum_s: float


class Histograms:
    """As many histograms with the same buckets as a row of durations has columns.

    Lists and `bisect`: for the ten numbers of a tick that is twice as fast as NumPy.
    """

    def __init__(self, columns: int, bounds_s: Sequence[float]) -> None:
        self._bounds_s = tuple(bounds_s)
        self._bounds_ns = [round(bound * 1e9) for bound in bounds_s]
        self._counts = [[0] * (len(bounds_s) + 1) for _ in range(columns)]
        self._sum_ns = [0] * columns

    def add(self, durations_ns: Sequence[int]) -> None:
        """Count one duration a column; what is negative did not happen."""
        for column, duration_ns in enumerate(durations_ns):
            if duration_ns >= 0:
                self.add_one(column, duration_ns)

    def add_one(self, column: int, duration_ns: int) -> None:
        """Count one duration, which is not negative, in one column."""
        self._counts[column][bisect_left(self._bounds_ns, duration_ns)] += 1
        self._sum_ns[column] += duration_ns

    def read(self) -> list[Histogram]:
        """All as they stand, by column."""
        return [
            Histogram(self._bounds_s, tuple(counts), sum_ns * 1e-9)
            for counts, sum_ns in zip(self._counts, self._sum_ns, strict=True)
        ]
