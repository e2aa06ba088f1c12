"""When a process that ended is started again."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import ModelProcess
from edge.perception.process.kept import Pause, Restarts

CONFIG = ModelProcess(backoff_s=1.0, backoff_max_s=5.0, restarts=4, window_s=60.0)


def pauses(runs, **changes):
    """The pause after each end of a process that was ready for so many seconds."""
    restarts = Restarts(CONFIG.model_copy(update=changes))
    return [restarts.after(ran_s) for ran_s in runs]


def starts(*seconds):
    return [Pause(s, False) for s in seconds]


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        ([], []),
        ([0], starts(1)),
        ([0, 0, 2, 0], starts(1, 2, 4, 5)),
        ([0, 0, 6, 0], starts(1, 2, 1, 2)),
        ([0, 3, 0, 40, 0, 50], [*starts(1, 2, 4, 1), Pause(60, True), Pause(60, True)]),
        ([0, 0, 0, 0, 0, 61, 0], [*starts(1, 2, 4, 5), Pause(60, True), *starts(1, 2)]),
    ],
    ids=["none", "one", "backoff", "a while of health", "limit", "well again"],
)
def test_pauses(runs, expected):
    assert pauses(runs) == expected


def test_no_restart_at_all():
    assert pauses([9, 9], restarts=0) == [Pause(math.inf, True)] * 2


@given(st.lists(st.floats(0, 200), max_size=60), st.integers(1, 6), st.floats(1, 100))
def test_so_many_ends_in_a_row_reach_the_limit_and_only_a_long_run_lifts_it(
    runs, restarts, window_s
):
    made = pauses(runs, restarts=restarts, window_s=window_s)
    for k, pause in enumerate(made):
        in_a_row = 1
        while in_a_row <= k and runs[k + 1 - in_a_row] <= window_s:
            in_a_row += 1
        assert pause.limit == (in_a_row > restarts)
        assert pause.seconds >= (window_s if pause.limit else CONFIG.backoff_s)
