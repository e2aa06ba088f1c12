"""The progress line: its words, its beat, and that it fits the terminal."""

from __future__ import annotations

import io

import pytest

from edge.cli.progress import Progress, ProgressWriter, format_line
from edge.logs import CLEAR_LINE

S = 1_000_000_000


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("progress", "line"),
    [
        (Progress("searching", "chair"), "0.0s searching chair | no goal | 0 seen | map 0 m2"),
        (
            Progress("approaching", "sofa", 61.26, "instance", 1.24, 2, 40.6, 1.96, 8.7),
            "61.3s approaching sofa | instance 1.2 m | 2 seen | map 41 m2 "
            "| tick p95 2.0 ms | detector 9 ms",
        ),
        (Progress("x", "a\x1b[2Jb\n"), "0.0s x a[2Jb | no goal | 0 seen | map 0 m2"),
    ],
)
def test_format_line(progress, line):
    assert format_line(progress) == line


@pytest.mark.parametrize(("stream", "written"), [(Terminal, 10), (io.StringIO, 1)])
def test_beat(stream, written):
    out = stream()
    writer = ProgressWriter(out)
    for k in range(60):  # two seconds of a 30 Hz loop
        writer.update(Progress("searching", "chair", elapsed_s=k / 30), k * S // 30)
    assert out.getvalue().count("searching") == written


def test_a_log_gets_whole_lines():
    out = io.StringIO()
    writer = ProgressWriter(out)
    for k in (0, 4, 5, 11):
        writer.update(Progress("searching", "chair", elapsed_s=k), k * S)
    writer.close()
    assert [line.split()[0] for line in out.getvalue().splitlines()] == ["0.0s", "5.0s", "11.0s"]
    assert "\x1b" not in out.getvalue()


def test_a_terminal_gets_one_line_that_fits():
    out = Terminal()
    writer = ProgressWriter(out)
    for k in range(3):
        writer.update(Progress("searching", "x" * 300), k * S)
    writer.close()
    lines = out.getvalue().removesuffix("\n").split(CLEAR_LINE)
    assert (lines[0], len(lines)) == ("", 4)
    assert all(len(line) < 80 and "\n" not in line for line in lines)
    assert out.getvalue().endswith("\n")


def test_nothing_to_close():
    out = Terminal()
    ProgressWriter(out).close()
    assert out.getvalue() == ""
