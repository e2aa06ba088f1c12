"""Periodic work in the background of a block."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger("edge.host.periodic")


@contextmanager
def run_periodically(name: str, every_s: float, work: Callable[[], object]) -> Iterator[None]:
    """Call `work` every `every_s` seconds on a daemon thread, while the block runs.

    The first call comes after `every_s`. At the end, the block waits for a running call. An error
    of `work` is logged, the first of each type, and does not end the thread.
    """
    over = threading.Event()
    logged: set[type[Exception]] = set()

    def call_until_over() -> None:
        while not over.wait(every_s):
            try:
                work()
            except Exception as error:
                if type(error) not in logged:
                    logged.add(type(error))
                    log.exception("%s: trying again; further errors of this type are not logged",
                                  name)  # fmt: skip

    thread = threading.Thread(target=call_until_over, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
