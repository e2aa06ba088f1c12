"""Processes of ROS's Python and of ours, whose output is kept, as long as a test holds them."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from live_patience import PATIENCE_S, eventually

STOP_S = PATIENCE_S


class Process:
    """A process and the lines that it has said so far."""

    def __init__(self, command: list[str], environ: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            command, env={**os.environ, **environ}, stdin=subprocess.PIPE, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def says(self, what: str, times: int = 1) -> None:
        """Wait until this many lines contain the text."""
        eventually(
            lambda: self.count(what) >= times or self.process.poll() is not None,
            lambda: f"never said {what!r}: {self.lines}",
        )
        if self.process.poll() is not None:
            self._reader.join(STOP_S)  # its last words may yet have to be read
        assert self.count(what) >= times, self.lines

    def count(self, what: str) -> int:
        return sum(what in line for line in self.lines)

    def end(self) -> int:
        """Return the exit code. Peers end with their input, `edge` commands on a signal."""
        self.process.stdin.close()
        self.process.terminate()
        return self.process.wait(STOP_S)


@contextmanager
def running(command: list[str], environ: dict[str, str]) -> Iterator[Process]:
    process = Process(command, environ)
    try:
        yield process
    finally:
        if process.process.poll() is None:
            process.end()
