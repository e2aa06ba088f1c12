"""Rates of a sink's messages."""

from __future__ import annotations

import pytest

from edge.sinks.rate_limiter import RateLimiter


@pytest.mark.parametrize(
    ("times_s", "due"),
    [
        ([], []),
        ([0.0, 0.4, 0.5, 0.9, 1.0], [True, False, True, False, True]),
        ([5.0, 1.0, 1.4, 1.5], [True, True, False, True]),  # the clock was set back
    ],
)
def test_each_message_is_limited_to_its_rate(times_s, due):
    limiter = RateLimiter(map=2.0, status=1e-3)
    assert [limiter.take_turn("map", int(1e9 * t)) for t in times_s] == due
    assert limiter.take_turn("status", 0)
    assert not limiter.take_turn("status", 10**9)
