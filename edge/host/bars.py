"""A bar for work whose amount is known: rewritten on a terminal, printed now and then in a log."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from typing import Any, TypeVar

from tqdm import tqdm

from edge.text import one_line

TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0

T = TypeVar("T")


class _Lines:
    """A stderr that is a log: what tqdm would rewrite in place is a line of its own."""

    def write(self, text: str) -> None:
        if line := text.strip():
            sys.stderr.write(f"{line}\n")

    def flush(self) -> None:
        sys.stderr.flush()


class Bar(tqdm):
    """A context; it shows nothing of work that is done within a period.

    Args:
        what: is counted.
        total: None where it is not known.
        done: before this began.
        options: further ones of tqdm.
    """

    monitor_interval = 0  # its thread would only show that time goes by

    def __init__(self, what: str, total: int | None, done: int = 0, **options: Any) -> None:
        terminal = sys.stderr.isatty()
        period_s = TERMINAL_PERIOD_S if terminal else LOG_PERIOD_S
        super().__init__(
            desc=one_line(what), total=total, initial=done, leave=False, dynamic_ncols=True,
            file=sys.stderr if terminal else _Lines(), delay=period_s, mininterval=period_s,
            miniters=1, **options,
        )  # fmt: skip

    def reach(self, done: int) -> None:
        """So much is done in all."""
        self.update(done - self.n)


def counted(what: str, items: Collection[T]) -> Iterator[T]:
    """The items one after the other, while a bar says how many are done."""
    with Bar(what, len(items)) as bar:
        for item in items:
            yield item
            bar.update()
