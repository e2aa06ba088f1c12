"""Each signal has its usual effect: stop, interrupt, or show the threads."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import pytest

from edge.host.signals import SHOW, STOP

# Says "stopped" at the first signal of STOP and waits for another; without `stop`, for the first.
# With `held`, the first comes when the main thread is just about to wait for it.
PROGRAM = """
import signal, sys, threading
# The tests themselves may run under `nohup`.
signal.signal(signal.SIGHUP, signal.SIG_IGN if "nohup" in sys.argv else signal.SIG_DFL)
from edge.host.signals import interrupt_on_signals, show_stacks_on_signals, stop_on_signals
interrupt_on_signals()
show_stacks_on_signals()
stop = stop_on_signals() if "stop" in sys.argv else threading.Event()
try:
    if "held" in sys.argv:
        with stop._cond:  # as `wait` does before it waits
            signal.raise_signal(signal.SIGTERM)
    if "elsewhere" in sys.argv:  # another thread gets it
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    print("ready", flush=True)
    # Without `stop`, nothing wakes a thread whose signal came just before it began to wait.
    while not stop.wait(None if "stop" in sys.argv else 1.0):
        pass
    print("stopped", flush=True)
    threading.Event().wait()
except KeyboardInterrupt as broken_off:
    print("broken off by", broken_off.args[0], flush=True)
"""


@pytest.fixture
def start(script) -> Callable[..., subprocess.Popen]:
    """Start a program with these words; return once it handles signals."""

    def start(*words: str, program: str = PROGRAM, **options: object) -> subprocess.Popen:
        process = script("-c", program, *words, stderr=subprocess.PIPE, **options)
        assert process.stdout.readline() == "ready\n"
        return process

    return start


@pytest.mark.parametrize("number", STOP, ids=lambda number: number.name)
def test_the_first_stops_and_the_second_breaks_off(number, start):
    process = start("stop")
    process.send_signal(number)
    assert process.stdout.readline() == "stopped\n"
    process.send_signal(number)
    assert process.stdout.readline() == f"broken off by {int(number)}\n"
    assert process.wait() == 0


def test_a_stop_just_before_the_wait_does_not_deadlock(start):
    process = start("stop", "held")
    assert process.stdout.readline() == "stopped\n"


@pytest.mark.parametrize("number", STOP, ids=lambda number: number.name)
def test_the_first_signal_interrupts_if_nothing_checks_for_stops(number, start):
    process = start()
    process.send_signal(number)
    assert process.stdout.readline() == f"broken off by {int(number)}\n"


@pytest.mark.parametrize("number", SHOW, ids=lambda number: number.name)
def test_showing_the_threads_changes_nothing(number, start):
    process = start("stop")
    process.send_signal(number)
    assert "thread MainThread (most recent call last):\n" in iter(process.stderr.readline, "")
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "stopped\n"


HUNG = """
import ctypes
from edge.host.signals import show_stacks_on_signals, stop_on_signals
show_stacks_on_signals()
stop_on_signals()
lock, mutex = ctypes.CDLL(None).pthread_mutex_lock, ctypes.create_string_buffer(64)
lock(mutex)
print("ready", flush=True)
lock(mutex)  # for ever, and no signal ends it
"""


def test_the_threads_of_a_program_that_hangs_while_stopping_are_shown(start):
    process = start(program=HUNG)
    process.send_signal(signal.SIGTERM)
    time.sleep(0.3)
    process.send_signal(SHOW[0])
    assert select.select([process.stderr], [], [], 10.0)[0], "no stacks"
    assert "(most recent call last):" in process.stderr.readline()
    process.kill()


def test_a_closed_stderr_does_not_lose_later_signals(start):
    process = start("stop")
    process.stderr.close()
    process.send_signal(signal.SIGUSR1)
    time.sleep(0.3)  # two signals that are sent at once may come in either order
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "stopped\n"
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == f"broken off by {int(signal.SIGTERM)}\n"


def test_a_signal_in_another_thread_interrupts_the_main_thread(start):
    process = start("stop", "elsewhere")
    for line in ("stopped\n", f"broken off by {int(signal.SIGTERM)}\n"):
        process.send_signal(signal.SIGTERM)
        assert process.stdout.readline() == line


def test_a_hangup_ignored_by_nohup_stops_nothing(start):
    process = start("stop", "nohup")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "stopped\n"
    assert process.poll() is None, "SIGTERM was the first, not the second"


# Says "again" when it is asked to reload, "stopped" when it is to stop.
RELOADS = """
import signal, sys, threading
signal.signal(signal.SIGHUP, signal.SIG_IGN if "nohup" in sys.argv else signal.SIG_DFL)
from edge.host.signals import interrupt_on_signals, reload_on_sighup, stop_on_signals
interrupt_on_signals()
stop, again = stop_on_signals(), reload_on_sighup()
print("ready", flush=True)
while not stop.wait(0.01):
    if again.is_set():
        again.clear()
        print("again", flush=True)
print("stopped", flush=True)
"""


@pytest.fixture
def reloads(start) -> Callable[..., subprocess.Popen]:
    """Start it without a terminal, as a service manager does."""
    return partial(start, program=RELOADS, start_new_session=True)


def test_each_hangup_without_a_terminal_requests_a_reload(reloads):
    process = reloads()
    for _ in range(2):
        process.send_signal(signal.SIGHUP)
        assert process.stdout.readline() == "again\n"
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "stopped\n"
    assert process.wait() == 0, "the hang-ups did not count as first signals to stop"


def test_a_hangup_ignored_by_nohup_requests_no_reload(reloads):
    process = reloads("nohup")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "stopped\n"


def test_closing_the_terminal_stops_its_process():
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", RELOADS])
    said = b""
    while b"ready" not in said:
        said += os.read(terminal, 1024)
    os.kill(pid, signal.SIGHUP)
    while b"stopped" not in said:
        said += os.read(terminal, 1024)
    assert b"again" not in said
    assert os.waitpid(pid, 0)[1] == 0
    os.close(terminal)
