"""Gives memory back to the system."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager

EVERY_S = 60.0


@contextmanager
def trimmed(every_s: float = EVERY_S) -> Iterator[None]:
    """While the block lasts, memory that was freed goes back to the system now and then.

    glibc keeps what is freed between blocks that are still in use, and lets ever larger blocks
    come from there: after some reloads and changes of the camera a service held twice what it
    used. Trimming takes a millisecond, on a thread of its own. Another C library has no
    `malloc_trim`: nothing is done there.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is None:
        yield
        return
    over = threading.Event()

    def again() -> None:
        while not over.wait(every_s):
            trim(0)

    thread = threading.Thread(target=again, name="memory", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
