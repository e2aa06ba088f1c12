"""Facts in /proc about real processes."""

from __future__ import annotations

import subprocess
import sys

import psutil
import pytest
from live_patience import eventually

from edge.host.processes import Process, descendants, usage

NOBODY = 1 << 22  # the kernel's largest number, and more


def test_an_unknown_process_has_no_usage():
    assert usage(NOBODY) is None
    assert descendants(NOBODY) == []


def test_usage_agrees_with_psutil():
    theirs = psutil.Process()
    # A thread of another test may just be ending.
    eventually(lambda: usage(theirs.pid).threads == theirs.num_threads())
    ours = usage(theirs.pid)
    assert ours.descriptors == pytest.approx(theirs.num_fds(), abs=2)
    memory = theirs.memory_full_info()
    assert ours.memory_mb == pytest.approx(memory.rss / 1e6, rel=0.7)
    assert ours.memory_mb <= 1.1 * memory.rss / 1e6
    times = theirs.cpu_times()
    assert ours.cpu_s == pytest.approx(times.user + times.system, abs=0.5)


def test_descendants_are_found_at_any_depth():
    child = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'input()'])"
    parent = subprocess.Popen([sys.executable, "-c", child], stdin=subprocess.PIPE)
    try:
        # Until it is a program of its own it goes by its parent's command.
        found = eventually(
            lambda: [p for p in descendants(parent.pid) if p.command.endswith("-c input()")]
        )
        assert [process.parent for process in found] == [parent.pid]
        assert found[0] in descendants(psutil.Process().pid)
        assert found[0].is_running()
    finally:
        parent.stdin.close()
        parent.wait()
    eventually(lambda: not found[0].is_running())


def test_a_dead_unreaped_process_does_not_count():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)

    def found() -> list[Process]:
        return [p for p in descendants(psutil.Process().pid) if p.pid == child.pid]

    (process,) = found()
    child.stdin.close()
    eventually(lambda: not process.is_running())
    assert found() == []
    child.wait()
