"""Durations counted by bucket: the same as counting each against each bound."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.loop.histogram import INTERVAL_BOUNDS_S, STAGE_BOUNDS_S, Histograms

BOUNDS_S = (0.001, 0.01, 1.0)
NEVER = -1


def test_empty():
    (found,) = Histograms(1, BOUNDS_S).read()
    assert found == (BOUNDS_S, (0, 0, 0, 0), 0.0)


DURATIONS_NS = st.sampled_from([NEVER, 0, 10**6, 10**7, 10**9]) | st.integers(0, 3 * 10**9)


@given(st.lists(st.tuples(DURATIONS_NS, DURATIONS_NS)))
def test_every_duration_is_in_the_first_bucket_that_holds_it(rows):
    histograms = Histograms(2, BOUNDS_S)
    for row in rows:
        histograms.add(row)
    for column, found in enumerate(histograms.read()):
        durations_ns = [row[column] for row in rows if row[column] != NEVER]
        upto = [sum(d <= round(bound * 1e9) for d in durations_ns) for bound in BOUNDS_S]
        assert [sum(found.counts[: i + 1]) for i in range(3)] == upto
        assert sum(found.counts) == len(durations_ns)
        assert found.sum_s == pytest.approx(sum(durations_ns) * 1e-9)


@pytest.mark.parametrize("bounds_s", [STAGE_BOUNDS_S, INTERVAL_BOUNDS_S])
def test_bounds_rise(bounds_s):
    assert list(bounds_s) == sorted(set(bounds_s))
