"""Periodic work in the background of a block."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def run_periodically(name: str, every_s: float, work: Callable[[], object]) -> Iterator[None]:
    """Call `work` every `every_s` seconds on a daemon thread, while the block runs.

    The first call comes after `every_s`. At the end, the block waits for a running call.
    """
    over = threading.Event()

    def call_until_over() -> None:
        while not over.wait(every_s):
            work()

    thread = threading.Thread(target=call_until_over, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
