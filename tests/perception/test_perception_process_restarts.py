"""When a process that ended is started again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.perception.process import supervised
from edge.perception.process.supervised import WINDOW_S, RestartBackoff, RestartDelay


@pytest.fixture(autouse=True)
def _rules(monkeypatch):
    monkeypatch.setattr(supervised, "BACKOFF_S", 1.0)
    monkeypatch.setattr(supervised, "MOST_ENDS", 4)


def pauses(runs):
    """Return the pause after each end of a process that was ready for so many seconds."""
    restarts = RestartBackoff()
    return [restarts.after(ran_s) for ran_s in runs]


def starts(*seconds):
    return [RestartDelay(s, False) for s in seconds]


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        ([], []),
        ([0], starts(1)),
        ([0, 0, 2, 0], starts(1, 2, 4, 5)),
        ([0, 0, 6, 0], starts(1, 2, 1, 2)),
        (
            [0, 3, 0, 40, 0, 50],
            [*starts(1, 2, 4, 1), RestartDelay(60, True), RestartDelay(60, True)],
        ),
        ([0, 0, 0, 0, 0, 61, 0], [*starts(1, 2, 4, 5), RestartDelay(60, True), *starts(1, 2)]),
    ],
    ids=["none", "one", "backoff", "a while of health", "limit", "well again"],
)
def test_pauses(runs, expected):
    assert pauses(runs) == expected


@given(st.lists(st.floats(0, 200), max_size=60))
def test_ends_in_a_row_reach_the_limit(runs):
    for k, pause in enumerate(made := pauses(runs)):
        in_a_row = 1
        while in_a_row <= k and runs[k + 1 - in_a_row] <= WINDOW_S:
            in_a_row += 1
        assert pause.limit == (in_a_row > supervised.MOST_ENDS)
        assert pause.seconds >= (WINDOW_S if pause.limit else supervised.BACKOFF_S)
    assert len(made) == len(runs)
