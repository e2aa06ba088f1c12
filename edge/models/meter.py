"""How far a download is, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from edge.logs import CLEAR_LINE

TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0


def format_progress(what: str, have: int, total: int | None, per_s: float) -> str:
    """One line, without control characters.

    >>> format_progress("w.pt", 5_000_000, 20_000_000, 2.5e6)
    'w.pt: 5.0 of 20.0 MB (25 %), 2.5 MB/s, 6 s left'
    """
    if total is None:
        return f"{what}: {have / 1e6:.1f} MB, {per_s / 1e6:.1f} MB/s"
    left = f", {(total - have) / per_s:.0f} s left" if per_s > 0 else ""
    share = 100 * have // total if total else 100
    return (
        f"{what}: {have / 1e6:.1f} of {total / 1e6:.1f} MB ({share} %), "
        f"{per_s / 1e6:.1f} MB/s{left}"
    )


class Meter:
    """Rewrites one line of a terminal, or prints a line now and then to anything else.

    A context, which clears the line at its end.
    """

    def __init__(
        self,
        what: str,
        have: int = 0,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what, self._first, self._clock = what, have, clock
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._period_s = TERMINAL_PERIOD_S if self._terminal else LOG_PERIOD_S
        self._began_s = self._last_s = clock()

    def __enter__(self) -> Meter:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._terminal:
            self._write(CLEAR_LINE)

    def update(self, have: int, total: int | None) -> None:
        """Write the line if the last one is old enough."""
        now_s = self._clock()
        if now_s - self._last_s < self._period_s:
            return
        self._last_s = now_s
        per_s = (have - self._first) / (now_s - self._began_s)
        line = format_progress(self._what, have, total, per_s)
        self._write(CLEAR_LINE + line[:79] if self._terminal else line + "\n")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
