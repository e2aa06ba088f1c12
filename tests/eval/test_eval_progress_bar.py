"""The progress bar: its words and its beat, on a terminal and in a log."""

from __future__ import annotations

import io

import pytest

from edge.eval.progress_bar import WIDTH, ProgressBar, format_bar
from edge.logs import CLEAR_LINE


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def clock_of(*seconds: float):
    times = list(seconds)
    return lambda: times.pop(0)


@pytest.mark.parametrize(
    ("done", "total", "elapsed_s", "words"),
    [
        (0, 0, 0.0, "100 % 0/0 tasks"),
        (0, 100, 5.0, "  0 % 0/100 tasks"),
        (1, 1000, 5.0, "  0 % 1/1000 tasks"),
        (50, 100, 5.0, " 50 % 50/100 tasks, 5 s left"),
        (100, 100, 5.0, "100 % 100/100 tasks"),
    ],
)
def test_line(done, total, elapsed_s, words):
    line = format_bar("tasks", done, total, elapsed_s)
    bar, _, rest = line.partition("] ")
    assert rest == words
    assert len(bar) == 1 + WIDTH
    assert bar.count("#") == (WIDTH if not total else WIDTH * done // total)


def test_log_gets_a_line_now_and_then():
    stream = io.StringIO()
    with ProgressBar("tasks", 10, stream, clock_of(0.0, 1.0, 5.0, 6.0)) as bar:
        for done in (1, 5, 6):
            bar.update(done)
    assert stream.getvalue().splitlines() == [format_bar("tasks", 5, 10, 5.0)]


def test_terminal_is_rewritten_and_left_clean():
    stream = Terminal()
    with ProgressBar("tasks", 10, stream, clock_of(0.0, 0.1, 0.3)) as bar:
        bar.update(1)
        bar.update(2)
    text = stream.getvalue()
    assert text.count("tasks") == 1
    assert text.startswith(CLEAR_LINE)
    assert text.endswith(CLEAR_LINE)
    assert "\n" not in text
