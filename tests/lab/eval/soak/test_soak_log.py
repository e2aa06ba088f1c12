"""A log's reader that goes away, sticks, and comes back."""

from __future__ import annotations

import os
from contextlib import closing

import pytest

from edge.lab.eval.soak.log import Log


@pytest.fixture
def log(tmp_path):
    with closing(Log(tmp_path / "pipe", tmp_path / "kept")) as log:
        yield log


def test_nobody_writes_nothing(tmp_path):
    with closing(Log(tmp_path / "pipe", tmp_path / "kept")) as log:
        log.poll()
        assert log.lines == []
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_lines_are_read_once_they_are_whole_and_kept(log, tmp_path):
    writer = log.writer()
    for said, lines in ((b"a\nb", ["a"]), (b"c\n", ["a", "bc"]), (b"\xff\n", ["a", "bc", "�"])):
        os.write(writer, said)
        log.poll()
        assert [text for _, text in log.lines] == lines
    os.close(writer)
    assert (tmp_path / "kept").read_bytes() == b"a\nbc\n\xff\n"
    assert log.since(0.0) == ["a", "bc", "�"]
    assert log.since(log.lines[-1][0] + 1.0) == []


def test_without_a_reader_writing_fails_and_with_one_again_it_goes_on(log):
    writer = log.writer()
    log.leave()
    with pytest.raises(BrokenPipeError):
        os.write(writer, b"lost\n")
    log.open()
    os.write(writer, b"heard\n")
    log.poll()
    assert [text for _, text in log.lines] == ["heard"]
    os.close(writer)


def test_a_stuck_reader_has_the_pipe_full_until_it_reads_again(log):
    writer = log.writer()
    os.set_blocking(writer, False)
    log.stick()
    log.poll()
    with pytest.raises(BlockingIOError):
        os.write(writer, b"x")
    log.open()
    log.poll()
    os.write(writer, b"heard\n")
    log.poll()
    assert log.lines[-1][1] == "heard"
    os.close(writer)
