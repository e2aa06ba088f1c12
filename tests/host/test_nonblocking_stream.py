"""A stream that never blocks, on real pipes."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, suppress

import pytest
from patience import PATIENCE_S

from edge.host import nonblocking_stream as outlets
from edge.host.nonblocking_stream import MOST_WAITING, NonBlockingStream, nonblocking_stderr

LINE = "x" * 199 + "\n"
MUCH = 3 * MOST_WAITING  # lines, many times the size of a pipe


@pytest.fixture
def patient(monkeypatch):
    """Return the output written before the end, for a machine of any speed."""
    monkeypatch.setattr(outlets, "_END_S", PATIENCE_S)


@pytest.fixture
def pipe():
    """Its reading end, and a text stream that writes to it."""
    read, write = os.pipe()
    with open(write, "w", encoding="utf-8") as stream:
        yield read, stream
    with suppress(OSError):
        os.close(read)


def all_of(read: int) -> str:
    with open(read, encoding="utf-8", closefd=False) as reader:
        return reader.read()


def test_a_full_pipe_drops_and_counts_lines(pipe, monkeypatch):
    monkeypatch.setattr(outlets, "_END_S", 0.01)
    read, stream = pipe
    outlet = NonBlockingStream(stream)
    for _ in range(MUCH):
        assert outlet.write(LINE) == len(LINE)
    outlet.drain()  # without a reader
    came = lost = 0
    with open(read, encoding="utf-8", closefd=False) as reader:
        while came + lost < MUCH:  # neither more nor less, or it waits for ever
            if (line := reader.readline()) == LINE:
                came += 1
            else:
                assert line.endswith(" lines of output were dropped: the reader is too slow)\n")
                lost += int(line[1:].split()[0])
    assert lost > 0
    assert came + lost == MUCH


@pytest.mark.usefixtures("patient")
def test_output_to_a_closed_pipe_is_lost_without_an_error(pipe):
    read, stream = pipe
    os.close(read)
    outlet = NonBlockingStream(stream)
    for _ in range(MUCH):
        outlet.write(LINE)
    outlet.drain()
    assert not outlet._thread.is_alive()


@pytest.mark.usefixtures("patient")
def test_after_drain_writes_go_to_the_stream(pipe):
    read, stream = pipe
    outlet = NonBlockingStream(stream)
    outlet.write("before, ")
    outlet.drain()
    outlet.write("after")
    stream.close()
    assert all_of(read) == "before, after"


def test_a_stream_without_a_descriptor_is_left_alone():
    with redirect_stderr(io.StringIO()) as captured:
        with nonblocking_stderr():
            assert sys.stderr is captured
            print("told", file=sys.stderr)
        assert sys.stderr is captured
    assert captured.getvalue() == "told\n"


PROGRAM = f"""
import sys
from edge.cli.main import _exit_now_if_needed
from edge.host.nonblocking_stream import nonblocking_stderr
with nonblocking_stderr():
    for _ in range({MUCH}):
        sys.stderr.write({LINE!r})
    print("went on", flush=True)
sys.exit(_exit_now_if_needed(3))
"""


def test_a_process_runs_and_ends_with_a_blocked_log():
    program = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"went on\n"
        assert process.wait() == 3
