"""Error boundary of the loop: it catches and counts the exceptions of the loop's steps.

If a step (a tick, a request, a sink) raises, only its own work is lost and the loop continues. The
first error of each kind is logged (at debug level with its traceback), the others are only counted.
A step that fails again and again makes the service `degraded` until it succeeds. Exceptions that
end the process (`Stopped`, KeyboardInterrupt, SystemExit) pass through.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from edge.errors import Stopped
from edge.text import one_line

log = logging.getLogger("edge.loop.error_boundary")

DEGRADED_AFTER = 30
"""Consecutive failures of one step after which the service is degraded: 1 s of ticks."""
TICK, IDLE = "tick", "idle"
"""Names of the steps of the runner: a tick, and a cycle without a usable observation."""

T = TypeVar("T")


class ErrorBoundary:
    """The error boundary; for the loop's thread.

    Attributes:
        failed: Number of exceptions that were caught.
        failures: Number of exceptions by `where: type`.
        last_error: Text of the newest exception; "" if there was none.

    Example:
        >>> boundary = ErrorBoundary(lambda text, now_ns: None)
        >>> with boundary.contain("sink", now_ns=0):
        ...     raise KeyError("x")
        >>> boundary.failures
        {'sink: KeyError': 1}
    """

    def __init__(self, event: Callable[[str, int], None]) -> None:
        self.failed = 0
        self.failures: dict[str, int] = {}
        self.last_error = ""
        self._event = event
        self._consecutive: dict[str, int] = {}  # failures in a row, by step

    @property
    def state(self) -> str:
        """`ok` or `degraded`."""
        worst = max(self._consecutive.values(), default=0)
        return "degraded" if worst >= DEGRADED_AFTER else "ok"

    @contextmanager
    def contain(self, step: str, now_ns: int) -> Iterator[None]:
        """Catch and count an exception of the body."""
        try:
            yield
        except Exception as error:
            self.on_error(step, error, now_ns)
        else:
            self.on_success(step, now_ns)

    def call(self, step: str, now_ns: int, work: Callable[[], T]) -> T | None:
        """Call `work` and return its result, or None if it raised.

        An empty result (None, an empty list, False) does not count as success: there may have been
        nothing to do.
        """
        try:
            result = work()
        except Exception as error:
            self.on_error(step, error, now_ns)
            return None
        if result:
            self.on_success(step, now_ns)
        return result

    def on_error(self, step: str, error: Exception, now_ns: int, where: str = "") -> None:
        """Count a failure of a step, and log the first of its kind.

        Raises:
            Stopped: `error` is Stopped, which is not a failure.
        """
        if isinstance(error, Stopped):
            raise error
        kind = f"{where or step}: {type(error).__name__}"
        self.failed += 1
        self.failures[kind] = self.failures.get(kind, 0) + 1
        self._consecutive[step] = self._consecutive.get(step, 0) + 1
        self.last_error = one_line(f"{kind} at {_raised_at(error)}: {error}")
        if self.failures[kind] == 1:
            log.error("%s (further errors of this kind are only counted)", self.last_error)
            log.debug("%s", kind, exc_info=error)
            self._event(f"failed: {self.last_error}", now_ns)
        if self._consecutive[step] == DEGRADED_AFTER:
            log.error("degraded: %s keeps failing: %s", step, self.last_error)
            self._event(f"degraded: {step} keeps failing: {self.last_error}", now_ns)

    def on_success(self, step: str, now_ns: int) -> None:
        """Record the success of a step."""
        if self._consecutive and self._consecutive.pop(step, 0) >= DEGRADED_AFTER:
            self._event(f"{step}: works again", now_ns)

    def status(self) -> dict[str, object]:
        """Return the part of the status message."""
        return {
            "state": self.state,
            "failed": self.failed,
            "last_error": self.last_error,
            "failures": dict(self.failures),
        }


def _raised_at(error: Exception) -> str:
    """Return the file and line that raised the error."""
    trace = error.__traceback__
    if trace is None:
        return "an unknown place"
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{os.path.basename(trace.tb_frame.f_code.co_filename)}:{trace.tb_lineno}"
