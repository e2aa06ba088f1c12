"""Gives memory back to the system."""

from __future__ import annotations

import ctypes
from contextlib import AbstractContextManager, nullcontext
from functools import partial

from edge.host.repeated import repeated

EVERY_S = 60.0


def trimmed(every_s: float = EVERY_S) -> AbstractContextManager[None]:
    """While the block lasts, memory that was freed goes back to the system now and then.

    glibc keeps what is freed between blocks that are still in use, and lets ever larger blocks
    come from there: after some reloads and changes of the camera a service held twice what it
    used. Trimming takes a millisecond, on a thread of its own. Another C library has no
    `malloc_trim`: nothing is done there.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return nullcontext() if trim is None else repeated("memory", every_s, partial(trim, 0))
