"""A non-blocking standard stream: its reader may be slow, stopped, or gone."""

from __future__ import annotations

import io
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from edge.host.interruptible import start_detached_thread

MOST_WAITING = 2000
"""Largest number of queued writes."""
_END_S = 1.0  # longest time to write what is queued at the end


class NonBlockingStream(io.TextIOBase):
    """A stream that accepts text without blocking; a thread writes it to the descriptor.

    At most `MOST_WAITING` writes are queued. Further writes are dropped, and a line with their
    number is written in their place. Errors of the descriptor are ignored.

    Raises:
        OSError: the stream has no descriptor.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._descriptor = stream, stream.fileno()
        self._waiting: deque[str] = deque()
        self._n_dropped = 0
        self._is_draining = False
        self._changed = threading.Condition()
        self._thread = start_detached_thread("stderr", self._write_texts)

    def write(self, text: str) -> int:
        """Queue the text without blocking; after `drain`, write it to the stream directly."""
        with self._changed:
            if not self._is_draining:
                if len(self._waiting) < MOST_WAITING:
                    self._waiting.append(text)
                else:
                    self._n_dropped += 1
                self._changed.notify()
                return len(text)
        return self._stream.write(text)

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._descriptor

    def drain(self) -> None:
        """Stop queueing, and wait at most 1 s until all text is written."""
        with self._changed:
            self._is_draining = True
            self._changed.notify()
        self._thread.join(_END_S)

    def _write_texts(self) -> None:
        """Write queued text until `drain` was called and nothing is left."""
        while True:
            with self._changed:
                while not (self._waiting or self._is_draining):
                    self._changed.wait()
                texts = [self._waiting.popleft() for _ in range(len(self._waiting))]
                if dropped := self._n_dropped:
                    texts.append(
                        f"({dropped} lines of output were dropped: the reader is too slow)\n"
                    )
                    self._n_dropped = 0
            if not texts:
                return
            # Not through the stream's buffer, whose lock the interpreter needs at exit.
            with suppress(OSError):
                _write_all(self._descriptor, "".join(texts).encode("utf-8", "backslashreplace"))


def _write_all(descriptor: int, content: bytes) -> None:
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left) :]


@contextmanager
def nonblocking_stderr() -> Iterator[None]:
    """Replace `sys.stderr` with a `NonBlockingStream` in this block, if stderr has a descriptor."""
    stderr = sys.stderr
    try:
        replacement = NonBlockingStream(stderr)
    except (OSError, AttributeError):  # captured in memory, so it never blocks
        yield
        return
    stderr.flush()
    sys.stderr = replacement
    try:
        yield
    finally:
        replacement.drain()
        sys.stderr = stderr
