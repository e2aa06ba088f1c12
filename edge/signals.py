"""What signals do: stop in order, break off, or show where every thread is."""

from __future__ import annotations

import faulthandler
import logging
import os
import queue
import signal
import threading
from collections.abc import Callable

log = logging.getLogger("edge")

STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
SHOW = (signal.SIGUSR1, signal.SIGUSR2)

_PARENT_LOOK_S = 1.0
_STDERR = 2


def break_off_on_signals() -> None:
    """Have any signal of `STOP` break off what is being done as Ctrl-C does: in order."""
    _handle(_break_off)


def stop_on_signals(parent: int | None = None) -> threading.Event:
    """An event that any signal of `STOP` sets.

    A second signal breaks off what is being done, children included; a third ends the process.

    Args:
        parent: set it too when this process is no longer the parent; one that was killed could
            not stop its children.
    """
    stop = threading.Event()
    told: queue.SimpleQueue[int] = queue.SimpleQueue()
    numbers: list[int] = []

    def handle(signum: int, frame: object) -> None:
        if numbers or stop.is_set():
            signal.signal(signum, signal.SIG_DFL)
            _break_off(signum, frame)
        numbers.append(signum)
        # The event has a lock, and the thread that is interrupted here may be holding it, about to
        # wait for the event: setting it would wait for ever. This queue may be put to anywhere.
        told.put(signum)

    def obey() -> None:
        log.info("%s: stopping", signal.Signals(told.get()).name)
        stop.set()

    threading.Thread(target=obey, name="stop", daemon=True).start()
    _handle(handle)
    if parent is not None:
        threading.Thread(target=_watch_parent, args=(parent, stop), daemon=True).start()
    return stop


def show_stacks_on_signals() -> None:
    """Have any signal of `SHOW` write to stderr where every thread is, and change nothing else."""
    for number in SHOW:
        faulthandler.register(number, file=_STDERR)


def _handle(handler: Callable[[int, object], None]) -> None:
    for number in STOP:
        # `nohup` has the hang-up of a terminal ignored, and means it.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _break_off(signum: int, _frame: object) -> None:
    raise KeyboardInterrupt(signum)


def _watch_parent(parent: int, stop: threading.Event) -> None:
    while not stop.wait(_PARENT_LOOK_S):
        if os.getppid() != parent:
            log.info("parent process is gone: stopping")
            stop.set()
