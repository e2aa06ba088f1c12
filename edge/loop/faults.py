"""What the loop's steps raised, and that the loop outlives it.

A step (a tick, a request, a sink) that raises costs what it was at, and nothing else: the next one
comes all the same. The first of each kind is told (at debug level with its traceback), the others
are counted. A step that fails without end makes the service `degraded` until it goes well again.
What is to end the process (`Stopped`, KeyboardInterrupt, SystemExit) passes through.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from edge.errors import Stopped
from edge.text import one_line

log = logging.getLogger("edge.loop.faults")

DEGRADED_AFTER = 30
"""So many failures in a row, of one step, are no bad moment: 1 s of ticks."""
TICK, IDLE = "tick", "idle"

T = TypeVar("T")


class Faults:
    """For one thread, the loop's.

    Args:
        event: tells of something that a person would want to know, at a time.

    Attributes:
        failed: how many exceptions the loop has outlived.
        failures: `where: type` of exception → how many.
        last_error: the newest of them in words; empty when there was none.
    """

    def __init__(self, event: Callable[[str, int], None]) -> None:
        self.failed = 0
        self.failures: dict[str, int] = {}
        self.last_error = ""
        self._event = event
        self._in_a_row: dict[str, int] = {}

    @property
    def state(self) -> str:
        """`ok` or `degraded`."""
        worst = max(self._in_a_row.values(), default=0)
        return "degraded" if worst >= DEGRADED_AFTER else "ok"

    @contextmanager
    def outlived(self, step: str, now_ns: int) -> Iterator[None]:
        """Counts what the body raises, instead of raising it."""
        try:
            yield
        except Exception as error:
            self.caught(step, error, now_ns)
        else:
            self.passed(step, now_ns)

    def attempt(self, step: str, now_ns: int, work: Callable[[], T]) -> T | None:
        """What the work returns, or None where it raised.

        Returning nothing (None, an empty list, False) is no sign that the step goes well: there may
        have been nothing to do.
        """
        try:
            found = work()
        except Exception as error:
            self.caught(step, error, now_ns)
            return None
        if found:
            self.passed(step, now_ns)
        return found

    def caught(self, step: str, error: Exception, now_ns: int, where: str = "") -> None:
        """A step failed.

        Args:
            where: the part of the step that raised, if that is known.

        Raises:
            Stopped: that is what `error` is, and no failure.
        """
        if isinstance(error, Stopped):
            raise error
        kind = f"{where or step}: {type(error).__name__}"
        self.failed += 1
        self.failures[kind] = self.failures.get(kind, 0) + 1
        self._in_a_row[step] = self._in_a_row.get(step, 0) + 1
        self.last_error = one_line(f"{kind} at {_place(error)}: {error}")
        if self.failures[kind] == 1:
            log.error("%s (more of these are only counted)", self.last_error)
            log.debug("%s", kind, exc_info=error)
            self._event(f"failed: {self.last_error}", now_ns)
        if self._in_a_row[step] == DEGRADED_AFTER:
            log.error("degraded: %s", self.last_error)
            self._event(f"degraded: {step} fails again and again: {self.last_error}", now_ns)

    def passed(self, step: str, now_ns: int) -> None:
        """A step went well."""
        if self._in_a_row and self._in_a_row.pop(step, 0) >= DEGRADED_AFTER:
            self._event(f"{step}: goes well again", now_ns)

    def status(self) -> dict[str, object]:
        """For the status message."""
        return {
            "state": self.state,
            "failed": self.failed,
            "last_error": self.last_error,
            "failures": dict(self.failures),
        }


def _place(error: Exception) -> str:
    """The line of code that raised it."""
    trace = error.__traceback__
    if trace is None:
        return "an unknown place"
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{os.path.basename(trace.tb_frame.f_code.co_filename)}:{trace.tb_lineno}"
