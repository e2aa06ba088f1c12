"""What a process says, read from a pipe that has a name: its reader can go away and come back."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

_CHUNK = 1 << 16


class Log:
    """Reads without waiting, and keeps the lines in a file.

    Attributes:
        lines: what was said, with when it was read (`time.monotonic`), oldest first.
    """

    def __init__(self, pipe: Path, kept: Path) -> None:
        self.lines: list[tuple[float, str]] = []
        self._pipe = pipe
        self._rest = b""
        os.mkfifo(pipe)
        self._file = kept.open("wb")
        self._reader: int | None = None
        self.open()

    def open(self) -> None:
        """Have a reader, where there is none, and have it read."""
        self._stuck = False
        if self._reader is None:
            self._reader = os.open(self._pipe, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)

    def leave(self) -> None:
        """Have no reader: who writes finds the pipe broken."""
        if self._reader is not None:
            os.close(self._reader)
            self._reader, self._rest = None, b""

    def stick(self) -> None:
        """Have a reader that does not read, and the pipe full: who writes waits."""
        self._stuck = True
        filling = os.open(self._pipe, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            for size in (_CHUNK, 1):  # what is not larger than a page goes in whole or not at all
                with suppress(BlockingIOError):
                    while True:
                        os.write(filling, b"\n" * size)
        finally:
            os.close(filling)

    def writer(self) -> int:
        """A descriptor for who is to write; the caller closes it."""
        return os.open(self._pipe, os.O_WRONLY | os.O_CLOEXEC)

    def poll(self) -> None:
        """Read what was said meanwhile."""
        if self._reader is None or self._stuck:
            return
        now_s = time.monotonic()
        while True:
            try:
                content = os.read(self._reader, _CHUNK)
            except BlockingIOError:
                break
            if not content:  # nobody writes (any more)
                break
            self._file.write(content)
            *whole, self._rest = (self._rest + content).split(b"\n")
            self.lines += [(now_s, line.decode("utf-8", "replace")) for line in whole]
        self._file.flush()

    def since(self, since_s: float) -> list[str]:
        """What was read since then."""
        first = len(self.lines)
        while first and self.lines[first - 1][0] >= since_s:
            first -= 1
        return [text for _, text in self.lines[first:]]

    def close(self) -> None:
        self.open()
        self.poll()
        self.leave()
        self._file.close()
        self._pipe.unlink()
