"""Log of all calls of an agent, and their limit."""

from __future__ import annotations

import json
import os
import time
from collections import deque
from pathlib import Path
from typing import Any

from edge.errors import FileError
from edge.text import one_line

MAX_CHARS = 500
"""Longest text of arguments or outcome in the log, in characters."""


class AuditLog:
    """A file of JSON lines that is only appended to.

    Each call has two lines with the same `call`: one before it is carried out, one with its
    outcome.

    Raises:
        FileError: the file cannot be written.
    """

    def __init__(self, path: Path, who: str) -> None:
        self.path, self._who, self._calls = path, one_line(who, 100), 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC
            self._handle = os.open(path, flags, 0o600)
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

    def close(self) -> None:
        os.close(self._handle)

    def _write(self, **fields: Any) -> None:
        entry = {"unix_s": round(time.time(), 3), "pid": os.getpid(), "agent": self._who, **fields}
        try:
            os.write(self._handle, json.dumps(entry).encode() + b"\n")
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror}") from None


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
