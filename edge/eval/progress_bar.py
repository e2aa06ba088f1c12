"""A bar for work whose amount is known: rewritten on a terminal, printed now and then in a log."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Iterator
from typing import TextIO, TypeVar

from edge.logs import CLEAR_LINE

TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0
WIDTH = 24

T = TypeVar("T")


def format_bar(what: str, done: int, total: int, elapsed_s: float) -> str:
    """The bar, without control characters.

    >>> format_bar("tasks", 500, 2000, 10.0)
    '[######------------------]  25 % 500/2000 tasks, 30 s left'
    """
    share = done / total if total else 1.0
    full = int(share * WIDTH)
    bar = "#" * full + "-" * (WIDTH - full)
    # The first pieces of work pay for what all share.
    known = 0.02 <= share < 1.0
    left = f", {elapsed_s * (total - done) / done:.0f} s left" if known else ""
    return f"[{bar}] {100 * share:3.0f} % {done}/{total} {what}{left}"


class ProgressBar:
    """Writes the bar to `stream` (stderr); a context that ends the rewritten line.

    Args:
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        what: str,
        total: int,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what, self._total, self._clock = what, total, clock
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._period_s = TERMINAL_PERIOD_S if self._terminal else LOG_PERIOD_S
        self._began_s = self._last_s = clock()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._terminal:
            self._stream.write(CLEAR_LINE)
            self._stream.flush()

    def update(self, done: int) -> None:
        """Write the bar if the last one is old enough."""
        now_s = self._clock()
        if now_s - self._last_s < self._period_s:
            return
        self._last_s = now_s
        line = format_bar(self._what, done, self._total, now_s - self._began_s)
        if self._terminal:
            self._stream.write(CLEAR_LINE + line[: self._columns() - 1])
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._stream.fileno()).columns or 80
        except (OSError, ValueError):
            return 80


def counted(what: str, items: Collection[T]) -> Iterator[T]:
    """The items one after the other, while a bar says how many are done."""
    with ProgressBar(what, len(items)) as bar:
        for done, item in enumerate(items, start=1):
            yield item
            bar.update(done)
