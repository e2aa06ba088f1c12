"""Return of freed memory to the operating system."""

from __future__ import annotations

import ctypes
from contextlib import AbstractContextManager, nullcontext
from functools import partial

from edge.host.periodic import run_periodically

EVERY_S = 60.0
"""Period in seconds."""


def trim_memory_periodically(every_s: float = EVERY_S) -> AbstractContextManager[None]:
    """Return freed memory to the system every `every_s` seconds, while the block runs.

    glibc keeps freed memory between blocks that are in use: after some reloads, a service held
    twice the memory that it used. Trimming takes about 1 ms, on a separate thread. Without
    `malloc_trim` (another C library) nothing is done.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return nullcontext() if trim is None else run_periodically("memory", every_s, partial(trim, 0))
