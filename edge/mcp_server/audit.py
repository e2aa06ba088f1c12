"""Log of all calls of an agent, and their limit."""

from __future__ import annotations

import json
import math
import os
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from edge.errors import FileError
from edge.text import one_line

MAX_CHARS = 500
"""Longest text of arguments or outcome in the log, in characters."""
MOST_BYTES = 16_000_000
"""Size of the log at which it is renamed to `NAME.1`, and a new one begins."""
_REFUSED_S = 60.0  # time between two lines of refused calls


class AuditLog:
    """A file of JSON lines that is only appended to.

    Each call has two lines with the same `call`: one before it is carried out, one with its
    outcome. Of the calls over the limit, only the first of each minute has a line.

    Raises:
        FileError: the file cannot be written.
    """

    def __init__(self, path: Path, who: str) -> None:
        self.path, self._who, self._calls = path, one_line(who, 100), 0
        self._refused, self._refused_s = 0, -math.inf  # refused calls since the last line; its time
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = self._open()
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror}") from None

    def begin(self, tool: str, arguments: object) -> int:
        """Write a call before it is carried out; return its number.

        Raises:
            FileError: the file cannot be written.
        """
        self._calls += 1
        shown = one_line(json.dumps(arguments, default=str)[: 4 * MAX_CHARS], MAX_CHARS)
        self._write(call=self._calls, tool=one_line(tool, 100), arguments=shown)
        return self._calls

    def end(self, call: int, outcome: str) -> None:
        """Write the outcome of a call.

        Raises:
            FileError: the file cannot be written.
        """
        self._write(call=call, outcome=one_line(outcome, MAX_CHARS))

    def refuse(self, tool: str, now_s: float) -> None:
        """Count a call over the limit, and write the first of each minute.

        Raises:
            FileError: the file cannot be written.
        """
        self._refused += 1
        if now_s - self._refused_s >= _REFUSED_S:
            self._write(tool=one_line(tool, 100), outcome="refused: too many calls a minute",
                        refused=self._refused)  # fmt: skip
            self._refused, self._refused_s = 0, now_s

    def close(self) -> None:
        os.close(self._handle)

    def _write(self, **fields: Any) -> None:
        entry = {"unix_s": round(time.time(), 3), "pid": os.getpid(), "agent": self._who, **fields}
        try:
            self._rotate()
            os.write(self._handle, json.dumps(entry).encode() + b"\n")
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror}") from None

    def _open(self) -> int:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC
        return os.open(self.path, flags, 0o600)

    def _rotate(self) -> None:
        """Begin a new file if this one is full; another process may have done so."""
        present = os.fstat(self._handle)
        if present.st_size < MOST_BYTES:
            return
        with suppress(FileNotFoundError):
            if os.path.samestat(present, os.stat(self.path)):
                os.replace(self.path, f"{self.path}.1")
        full, self._handle = self._handle, self._open()
        os.close(full)


class CallLimit:
    """A limit of calls in any minute."""

    def __init__(self, per_minute: int) -> None:
        self._per_minute, self._times_s = per_minute, deque[float]()

    def take(self, now_s: float) -> bool:
        """Count a call at this monotonic time, and return True if it is within the limit."""
        while self._times_s and now_s - self._times_s[0] >= 60.0:
            self._times_s.popleft()
        if len(self._times_s) >= self._per_minute:
            return False
        self._times_s.append(now_s)
        return True
