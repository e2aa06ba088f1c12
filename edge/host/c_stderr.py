"""A switch for C's stream `stderr`, to which image decoders print lines for each broken image.

OpenCV has no option to silence libpng or libjpeg. Only the C stream is switched off. The file
descriptor stays open, so logs of Python and reports of crashes are still written.
"""

from __future__ import annotations

import ctypes
import platform
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_n_blocks = 0  # number of blocks that silence the stream now


def _streams() -> tuple[ctypes.c_void_p, int | None, int | None] | None:
    """Return glibc's variable `stderr`, its stream, and a stream to /dev/null; None: no glibc."""
    if platform.libc_ver()[0] != "glibc":
        return None
    libc = ctypes.CDLL(None)
    libc.fopen.restype = ctypes.c_void_p
    variable = ctypes.c_void_p.in_dll(libc, "stderr")
    null_file = libc.fopen(b"/dev/null", b"we")
    return None if null_file is None else (variable, variable.value, null_file)


_STREAMS = _streams()


@contextmanager
def silence_c_stderr() -> Iterator[None]:
    """Drop what C libraries print to `stderr` in this block, on any thread."""
    if _STREAMS is None:
        yield
        return
    global _n_blocks
    variable, usual, null_file = _STREAMS
    with _lock:
        _n_blocks += 1
        variable.value = null_file
    try:
        yield
    finally:
        with _lock:
            _n_blocks -= 1
            if not _n_blocks:
                variable.value = usual
