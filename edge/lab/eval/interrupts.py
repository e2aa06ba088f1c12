"""Ctrl-C with worker processes: the parent alone is interrupted, and ends the others."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def holding_interrupts() -> Iterator[None]:
    """Hold SIGINT back in this thread, and in each process that it starts meanwhile.

    Otherwise Ctrl-C ends a process that still imports with a traceback. The process calls
    `ignore_interrupts` once it runs.
    """
    resource_tracker.ensure_running()  # its start lets SIGINT through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore_interrupts() -> None:
    """Ignore SIGINT in this process, also one that was held back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
