"""When a process that ended is started again."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import ModelProcess
from edge.perception.process.restarts import Pause, Restarts

CONFIG = ModelProcess(backoff_s=1.0, backoff_max_s=5.0, restarts=4, window_s=60.0)


def pauses(ends, **changes):
    """The pause after each end, given as (ran_s, now_s)."""
    restarts = Restarts(CONFIG.model_copy(update=changes))
    return [restarts.after(*end) for end in ends]


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ([], []),
        ([(0, 0)], [Pause(1, False)]),
        ([(0, 0), (0, 1), (2, 5), (0, 9)], [Pause(s, False) for s in (1, 2, 4, 5)]),
        ([(0, 0), (0, 1), (6, 9), (0, 10)], [Pause(s, False) for s in (1, 2, 1, 2)]),
        # Started at 1, 3, 9 and 15: the first of these leaves the window at 61.
        ([(0, 0), (0, 1), (0, 5), (0, 10), (0, 20)], [*(Pause(s, False) for s in (1, 2, 4, 5)),
                                                      Pause(41, True)]),
        # What is due anyhow when there is room again is not held up by the limit.
        ([(0, 0), (0, 1), (0, 5), (0, 10), (0, 56)], [*(Pause(s, False) for s in (1, 2, 4, 5)),
                                                      Pause(5, False)]),
    ],
    ids=["none", "one", "backoff", "a while of health", "limit", "room again"],
)  # fmt: skip
def test_pauses(ends, expected):
    assert pauses(ends) == expected


def test_no_restart_at_all():
    assert pauses([(9, 0), (9, 1)], restarts=0) == [Pause(math.inf, True)] * 2


@given(
    st.lists(st.tuples(st.floats(0, 20), st.floats(0, 20)), max_size=60),
    st.integers(1, 6),
    st.floats(1, 100),
)
def test_never_more_starts_in_a_window_than_allowed(ends, restarts, window_s):
    rules = Restarts(CONFIG.model_copy(update={"restarts": restarts, "window_s": window_s}))
    now_s, starts = 0.0, []
    for ran_s, took_s in ends:
        now_s += took_s + ran_s
        pause = rules.after(ran_s, now_s)
        assert pause.seconds >= CONFIG.backoff_s
        now_s += pause.seconds
        starts.append(now_s)
    for first, beyond in zip(starts, starts[restarts:], strict=False):
        assert beyond - first >= window_s - 1e-6
