"""The bar of counted work: silent at first, lines in a log, one rewritten line on a terminal."""

from __future__ import annotations

import contextlib
import io

import pytest

from edge.host import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def at_once(monkeypatch):
    monkeypatch.setattr(progress, "LOG_PERIOD_S", 0.0)
    monkeypatch.setattr(progress, "TERMINAL_PERIOD_S", 0.0)


def test_quick_work_shows_no_progress(capsys):
    assert list(progress.with_progress("tasks", "abc")) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("at_once")
def test_a_log_gets_progress_lines(capsys):
    assert list(progress.with_progress("tasks", "ab")) == ["a", "b"]
    shown = capsys.readouterr().err
    first, half, whole = shown.splitlines()
    assert first.startswith("tasks:   0%")
    assert half.startswith("tasks:  50%")
    assert " 2/2 [" in whole
    assert shown.isascii()


@pytest.mark.usefixtures("at_once")
def test_a_terminal_is_rewritten_and_left_clean():
    with (
        contextlib.redirect_stderr(Terminal()) as stream,
        progress.ProgressBar("tasks\x1b[2J", 4, done=1) as bar,
    ):
        bar.set_done(3)
    text = stream.getvalue()
    assert "tasks [2J:  75%" in text
    assert "3/4" in text
    assert "\n" not in text
    assert text.split("\r")[-2].strip() == ""
    assert text.endswith("\r")


@pytest.mark.usefixtures("at_once")
def test_bytes_of_an_unknown_total(capsys):
    with progress.ProgressBar("w.pt", None, unit="B", unit_scale=True) as bar:
        bar.set_done(5_000_000)
    assert "w.pt: 5.00MB [" in capsys.readouterr().err
