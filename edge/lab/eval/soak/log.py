"""Output of the soaked service, read from a named pipe whose reader can exit and come back."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

_CHUNK_BYTES = 1 << 16


class PipeLog:
    """Reads the pipe without blocking, and copies it to a file.

    Attributes:
        lines: the lines with the time of reading (`time.monotonic`), oldest first.
    """

    def __init__(self, pipe: Path, copy: Path) -> None:
        self.lines: list[tuple[float, str]] = []
        self._pipe = pipe
        self._rest = b""  # begin of a line whose end was not read yet
        os.mkfifo(pipe)
        self._file = copy.open("wb")
        self._reader: int | None = None
        self.open_reader()

    def open_reader(self) -> None:
        """Open a reader, if there is none, and let it read."""
        self._is_blocked = False
        if self._reader is None:
            self._reader = os.open(self._pipe, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)

    def close_reader(self) -> None:
        """Close the reader: writers get a broken pipe."""
        if self._reader is not None:
            os.close(self._reader)
            self._reader, self._rest = None, b""

    def block(self) -> None:
        """Fill the pipe and stop reading: writers block."""
        self._is_blocked = True
        filling = os.open(self._pipe, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            # Single bytes fill what a chunk leaves: a small write that does not fit writes nothing.
            for size in (_CHUNK_BYTES, 1):
                with suppress(BlockingIOError):
                    while True:
                        os.write(filling, b"\n" * size)
        finally:
            os.close(filling)

    def writer(self) -> int:
        """Open the pipe for a writer; the caller closes the descriptor."""
        return os.open(self._pipe, os.O_WRONLY | os.O_CLOEXEC)

    def poll(self) -> None:
        """Read what the pipe holds."""
        if self._reader is None or self._is_blocked:
            return
        now_s = time.monotonic()
        while True:
            try:
                content = os.read(self._reader, _CHUNK_BYTES)
            except BlockingIOError:
                break
            if not content:  # no writer
                break
            self._file.write(content)
            *complete_lines, self._rest = (self._rest + content).split(b"\n")
            self.lines += [(now_s, line.decode("utf-8", "replace")) for line in complete_lines]
        self._file.flush()

    def since(self, since_s: float) -> list[str]:
        """Return the lines read since a time."""
        first = len(self.lines)
        while first and self.lines[first - 1][0] >= since_s:
            first -= 1
        return [text for _, text in self.lines[first:]]

    def close(self) -> None:
        """Read the rest, and remove the pipe."""
        self.open_reader()
        self.poll()
        self.close_reader()
        self._file.close()
        self._pipe.unlink()
