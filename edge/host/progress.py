"""Progress bars: rewritten in place on a terminal, printed every 5 s to a log."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from typing import Any, TypeVar

from tqdm import tqdm

from edge.text import one_line

# Time between two updates, in seconds.
TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0

T = TypeVar("T")


class _Lines:
    """Stream for tqdm that writes each update as a new line to stderr, for logs."""

    def write(self, text: str) -> None:
        if line := text.strip():
            sys.stderr.write(f"{line}\n")

    def flush(self) -> None:
        sys.stderr.flush()


class ProgressBar(tqdm):
    """A progress bar, used as a context. Work that ends within a period shows nothing.

    Args:
        what: text before the bar: the name of the work.
        total: amount of work; None: unknown.
        done: amount that was done before.
        options: further options of tqdm.
    """

    monitor_interval = 0  # tqdm's monitor thread is not needed

    def __init__(self, what: str, total: int | None, done: int = 0, **options: Any) -> None:
        terminal = sys.stderr.isatty()
        period_s = TERMINAL_PERIOD_S if terminal else LOG_PERIOD_S
        super().__init__(
            desc=one_line(what), total=total, initial=done, leave=False, dynamic_ncols=True,
            file=sys.stderr if terminal else _Lines(), delay=period_s, mininterval=period_s,
            miniters=1, **options,
        )  # fmt: skip

    def set_done(self, done: int) -> None:
        """Set the total amount that is done."""
        self.update(done - self.n)


def with_progress(what: str, items: Collection[T]) -> Iterator[T]:
    """Yield the items, and show their number on a bar."""
    with ProgressBar(what, len(items)) as bar:
        for item in items:
            yield item
            bar.update()
