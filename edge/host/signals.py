"""Signal handlers: stop in order, interrupt, reload, or print the stacks of all threads.

A signal has two effects. Its action runs at once, on a separate thread. Its Python handler runs
later, in the main thread.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial

log = logging.getLogger("edge")

STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that stop the process."""
SHOW = (signal.SIGUSR1, signal.SIGUSR2)
"""Signals that print the stacks of all threads."""

_PARENT_PERIOD_S = 1.0
_WAKE = signal.SIGURG  # sent to the main thread, to wake it
_WAKE_S = 0.05  # period of `_WAKE`

# Signal → action. Python handlers are not enough: a signal to another thread does not wake the main
# thread, and a handler must take no lock, since the main thread may hold it.
_actions: dict[int, Callable[[int], None]] = {}
# Kept open, since the interpreter writes the number of each signal to its descriptor.
_wakeup_socket: socket.socket | None = None


def interrupt_on_signals() -> None:
    """Make every signal of `STOP` raise KeyboardInterrupt, as Ctrl-C does."""
    _set_handler(_interrupt)


def stop_on_signals(parent: int | None = None) -> threading.Event:
    """Return an event that every signal of `STOP` sets.

    A second signal raises KeyboardInterrupt; a third one ends the process.

    Args:
        parent: process id of the parent. The event is also set when the parent is gone, since a
            killed parent cannot stop its children. None: do not watch it.
    """
    stop = threading.Event()
    handled: list[int] = []  # numbers of the signals that the main thread has handled
    n_signals = 0  # signals that came

    def handle(signum: int, frame: object) -> None:
        handled.append(signum)
        if len(handled) > 1:
            signal.signal(signum, signal.SIG_DFL)
            _interrupt(signum, frame)

    def stop_now(signum: int) -> None:
        nonlocal n_signals
        n_signals += 1
        if n_signals == 1:
            log.info("%s: stopping", signal.Signals(signum).name)
        stop.set()
        # On its own thread: a main thread that hangs must not block the actions of other signals.
        wake = partial(_wake_main_thread, lambda: len(handled) >= n_signals)
        threading.Thread(target=wake, name="wake", daemon=True).start()

    signal.signal(_WAKE, lambda signum, frame: None)
    _add_actions(dict.fromkeys(STOP, stop_now))
    _set_handler(handle)
    if parent is not None:
        threading.Thread(target=_watch_parent, args=(parent, stop), daemon=True).start()
    return stop


def reload_on_sighup() -> threading.Event:
    """Return an event that SIGHUP sets, instead of stopping the process.

    If the process has a terminal, or `nohup` ignores SIGHUP, the meaning of SIGHUP is not changed
    and the event is never set.
    """
    requested = threading.Event()
    if not _has_terminal() and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        _add_actions({signal.SIGHUP: lambda signum: requested.set()})
        signal.signal(signal.SIGHUP, lambda signum, frame: None)
    return requested


def show_stacks_on_signals() -> None:
    """Make every signal of `SHOW` write the stacks of all threads to stderr."""
    _add_actions(dict.fromkeys(SHOW, _show_stacks))
    for number in SHOW:
        signal.signal(number, lambda signum, frame: None)


def _set_handler(handler: Callable[[int, object], None]) -> None:
    for number in STOP:
        # Keep a SIGHUP that `nohup` has set to be ignored.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(signum: int, _frame: object) -> None:
    raise KeyboardInterrupt(signum)


def _add_actions(actions: dict[int, Callable[[int], None]]) -> None:
    """Run these actions when their signals come; each signal needs a Python handler, too."""
    global _wakeup_socket
    _actions.update(actions)
    if _wakeup_socket is None:
        read, _wakeup_socket = socket.socketpair()
        _wakeup_socket.setblocking(False)
        signal.set_wakeup_fd(_wakeup_socket.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=_run_actions, args=(read,), name="signals", daemon=True).start()


def _run_actions(numbers: socket.socket) -> None:
    while True:
        number = numbers.recv(1)[0]
        if (action := _actions.get(number)) is not None:
            action(number)


def _wake_main_thread(has_handled: Callable[[], bool]) -> None:
    """Interrupt what the main thread waits for, until it has handled its signals.

    A signal that comes just before the main thread begins to wait does not end that wait.
    """
    main = threading.main_thread()
    while not has_handled() and main.is_alive():
        signal.pthread_kill(main.ident, _WAKE)
        time.sleep(_WAKE_S)


def _show_stacks(_signum: int) -> None:
    """Write the stacks of all threads to stderr."""
    # Not with `faulthandler`, which reads the frames of running threads and has crashed.
    names = {thread.ident: thread.name for thread in threading.enumerate()}
    parts = []
    for ident, frame in sys._current_frames().items():
        parts.append(f"thread {names.get(ident, ident)} (most recent call last):\n")
        parts += traceback.format_stack(frame)
    with suppress(OSError):  # no reader; this thread must go on
        sys.stderr.write("".join(parts))
        sys.stderr.flush()


def _has_terminal() -> bool:
    """Return True if the process has a controlling terminal."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_CLOEXEC))
    except OSError:
        return False
    return True


def _watch_parent(parent: int, stop: threading.Event) -> None:
    while not stop.wait(_PARENT_PERIOD_S):
        if os.getppid() != parent:
            log.info("parent process is gone: stopping")
            stop.set()
