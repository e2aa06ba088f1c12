"""Input log: all that enters the loop in addition to observations, in order.

Observations and this log determine all that the loop does. A service that gets both a second time
does exactly the same (`edge.recording.replay`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

DETECTOR = "detector"
"""Name of the detector's worker in the log."""
TASK = "task"
"""Name of the worker that plans trajectories of tasks."""
FRAME_DECISION = "elsewhere"
"""Recorded decision: why `map` is not the frame of the checkpoint, "" if it is the same."""
USE = "use"
"""Recorded decision: the permitted use of an observation (`edge.loop.checks.plausibility.Use`)."""
SIGHTED = "sighted"
"""Recorded decision: the loop time until which a refused observation still shows the
surroundings."""
_MAX_ENTRIES = 4096  # largest number of entries between two results; older entries are dropped


class LoopInput(NamedTuple):
    """One entry of the input log.

    Attributes:
        n: Number of the entry, from 0. A gap shows lost entries.
        kind: Kind of the entry. It determines the `fields`; see docs/recording.md.
        fields: Values by name.
    """

    n: int
    kind: str
    fields: dict[str, Any]


class InputLog:
    """The input log; for the loop's thread.

    Attributes:
        pending: Entries since the last result; bounded.
    """

    def __init__(self) -> None:
        self.pending: deque[LoopInput] = deque(maxlen=_MAX_ENTRIES)
        self._n = 0

    def note(self, kind: str, **fields: Any) -> None:
        """Add an entry. The log keeps the values without a copy, so they must not change."""
        self.pending.append(LoopInput(self._n, kind, fields))
        self._n += 1

    def record_decision(
        self, what: str, decide: Callable[[], str], usual: str | None = None
    ) -> str:
        """Make and log a decision that depends on this computer or its clocks.

        Args:
            what: Name of the decision.
            decide: Function that makes the decision.
            usual: A decision that is not logged. A replay uses it if none was logged.
        """
        decision = decide()
        if decision != usual:
            self.note("decision", name=what, value=decision)
        return decision

    def wrap(self, name: str, worker: Any) -> Any:
        """Return a worker with the same interface that logs its requests and results.

        A result is logged when the loop polls it.
        """
        return _LoggedWorker(name, worker, self)


class _LoggedWorker:
    """A worker that logs its requests and results; see `InputLog.wrap`."""

    def __init__(self, name: str, worker: Any, input_log: InputLog) -> None:
        self._name, self._worker, self._input_log = name, worker, input_log

    def __getattr__(self, name: str) -> Any:
        return getattr(self._worker, name)

    def submit(self, item: Any) -> None:
        if self._name != DETECTOR:  # the detector gets every image, so this is not logged
            self._input_log.note("request", worker=self._name)
        self._worker.submit(item)

    def poll(self) -> Any:
        result = self._worker.poll()
        if result is not None:
            self._input_log.note("result", worker=self._name, result=result)
        return result
