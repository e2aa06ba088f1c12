"""A standard stream that nobody waits for: whoever reads it may be slow, stopped, or gone."""

from __future__ import annotations

import io
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from edge.host.interruptible import start_unjoined

MOST_WAITING = 2000
_END_S = 1.0


class Outlet(io.TextIOBase):
    """Takes text at once; a thread writes it to a stream's descriptor.

    Of what comes while `MOST_WAITING` writes wait the newest are lost, and how many that were is
    told in their place. What nobody reads any more is lost as well.
    """

    def __init__(self, stream: TextIO) -> None:
        """
        Raises:
            OSError: the stream has no descriptor.
        """
        self._stream, self._descriptor = stream, stream.fileno()
        self._waiting: deque[str] = deque()
        self._lost = 0
        self._ends = False
        self._hand = threading.Condition()
        self._thread = start_unjoined("stderr", self._pass_on)

    def write(self, text: str) -> int:
        """Never waits; after `end` it is the stream's own."""
        with self._hand:
            if not self._ends:
                if len(self._waiting) < MOST_WAITING:
                    self._waiting.append(text)
                else:
                    self._lost += 1
                self._hand.notify()
                return len(text)
        return self._stream.write(text)

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._descriptor

    def end(self) -> None:
        """Wait for a second, at most, for what was written to be read."""
        with self._hand:
            self._ends = True
            self._hand.notify()
        self._thread.join(_END_S)

    def _pass_on(self) -> None:
        while True:
            with self._hand:
                while not (self._waiting or self._ends):
                    self._hand.wait()
                texts = [self._waiting.popleft() for _ in range(len(self._waiting))]
                if self._lost:
                    texts.append(f"({self._lost} lines were not read in time, and are lost)\n")
                    self._lost = 0
            if not texts:
                return
            # Past the stream's buffer, whose lock the interpreter wants at its end.
            with suppress(OSError):
                _write_all(self._descriptor, "".join(texts).encode("utf-8", "backslashreplace"))


def _write_all(descriptor: int, content: bytes) -> None:
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left) :]


@contextmanager
def unwaited_stderr() -> Iterator[None]:
    """Have `sys.stderr` be an `Outlet` in this block; one without a descriptor stays."""
    stderr = sys.stderr
    try:
        outlet = Outlet(stderr)
    except (OSError, AttributeError):  # nothing that a program captures for itself is waited for
        yield
        return
    stderr.flush()
    sys.stderr = outlet
    try:
        yield
    finally:
        outlet.end()
        sys.stderr = stderr
