"""Work that is done again and again beside a block."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def repeated(name: str, every_s: float, work: Callable[[], object]) -> Iterator[None]:
    """Do it every so often on a daemon thread, for the first time after `every_s`, until the block
    ends; then wait for what is under way."""
    over = threading.Event()

    def again() -> None:
        while not over.wait(every_s):
            work()

    thread = threading.Thread(target=again, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
