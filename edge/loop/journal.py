"""What comes into the loop from beside it, in order.

With the observations it decides all that the loop does: a service that is given the same again
does the same again (`edge.recording.replay`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

DETECTOR = "detector"
TASK = "task"
ELSEWHERE = "elsewhere"
"""As a decision: why `map` is not the frame of before a restart, "" where it is."""
USE, SIGHTED = "use", "sighted"
"""As decisions: what an observation is good for (`edge.loop.plausibility.Use`), and the loop time
until which a refused one shows the surroundings."""
_KEPT = 4096  # of what came between two results, the newest


class Input(NamedTuple):
    """One thing that came.

    Attributes:
        n: counts them from 0, so that a gap is seen.
        kind: what it is, and with it which `fields` there are: see docs/recording.md.
    """

    n: int
    kind: str
    fields: dict[str, Any]


class Journal:
    """Notes all that comes in; for one thread, the loop's.

    Attributes:
        pending: since the last result; bounded, however long ago that is.
    """

    def __init__(self) -> None:
        self.pending: deque[Input] = deque(maxlen=_KEPT)
        self._n = 0

    def note(self, kind: str, **fields: Any) -> None:
        """Something came. What is given is kept as it is, and must not change any more."""
        self.pending.append(Input(self._n, kind, fields))
        self._n += 1

    def decided(self, what: str, decide: Callable[[], str], usual: str | None = None) -> str:
        """What only the run itself can know, by its computer and its clocks; noted.

        Args:
            usual: the answer that is not noted, and that a replay takes if none was.
        """
        said = decide()
        if said != usual:
            self.note("decided", what=what, said=said)
        return said

    def beside(self, name: str, worker: Any) -> Any:
        """A worker with the same interface, of which is noted when it was asked, and what it found
        when the loop took it up."""
        return _Noted(name, worker, self)


class _Noted:
    """See `Journal.beside`."""

    def __init__(self, name: str, worker: Any, journal: Journal) -> None:
        self._name, self._worker, self._journal = name, worker, journal

    def __getattr__(self, name: str) -> Any:
        return getattr(self._worker, name)

    def submit(self, item: Any) -> None:
        if self._name != DETECTOR:  # which is handed every image
            self._journal.note("asked", worker=self._name)
        self._worker.submit(item)

    def poll(self) -> Any:
        found = self._worker.poll()
        if found is not None:
            self._journal.note("found", worker=self._name, what=found)
        return found
