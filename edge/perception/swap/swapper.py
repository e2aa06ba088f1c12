"""Another model in the running service: loaded beside, tried, switched to, watched, kept or not.

The running model goes on until the new one was tried on its images, and it is kept, open, until
the new one has run clean on `perception.swap.probation` images. Loading and trying happen on a
thread (`attempt.py`); the loop only looks, once a tick, whether it is time for the next step. A
swap that fails at any point leaves the model that ran before, and one line.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from edge.config import Perception
from edge.errors import UserError
from edge.perception.detector import Detector, make_detector
from edge.perception.swap.attempt import Attempt, Make
from edge.perception.worker import DetectorWorker

log = logging.getLogger("edge.swap")

OVER = ("kept", "rolled back", "refused")
_CLOSE_S = 5.0


class SwapError(UserError):
    """Why no swap was begun; one line."""


class Swapper:
    """Swaps the worker's detector; `request`, `step` and `close` are for the loop's thread.

    Args:
        tell: called with a line for everything that happens, and the loop's time.
        make: makes the new detector.
        clock: seconds, for `load_timeout_s`.
    """

    def __init__(
        self,
        perception: Perception,
        worker: DetectorWorker,
        tell: Callable[[str, int], None],
        make: Make = make_detector,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._perception, self._worker, self._tell = perception, worker, tell
        self._make, self._clock = make, clock
        self._attempt: Attempt | None = None
        self._until_s = 0.0
        self._number = 0
        self._over = {"state": "idle", "model": worker.detector.name, "previous": "", "detail": ""}
        self._closing: list[threading.Thread] = []
        self._late: tuple[str, threading.Thread | None] = ("", None)

    def request(self, model: str, force: bool, now_ns: int) -> None:
        """Begin to swap a model in.

        Args:
            model: a detector's card.
            force: too slow or too different is told, not held against it.

        Raises:
            SwapError: it runs already, another swap is under way, or a model that was refused
                is still being loaded and would be a third one in memory.
        """
        if (attempt := self._attempt) is not None:
            raise SwapError(f"{attempt.model} is still {self.state}; wait until that is over")
        running = self._worker.detector.name
        if model == running:
            raise SwapError(f"{model} runs already")
        late, letting_go = self._late
        if letting_go is not None and letting_go.is_alive():
            raise SwapError(f"{late}, which was refused, is still being loaded; try again later")
        self._number += 1
        self._until_s = self._clock() + self._perception.swap.load_timeout_s
        self._attempt = Attempt(model, force, self._perception, self._worker, self._make)
        self._worker.watch = self._attempt.see
        self._tell(f"model {model}: loading beside {running}", now_ns)

    def step(self, now_ns: int) -> None:
        """Take the next step if it is time for one: between two ticks, and never waiting."""
        attempt = self._attempt
        if attempt is None:
            return
        if attempt.switched:
            self._watch(attempt, now_ns)
        elif attempt.fault:
            self._refuse(attempt, attempt.fault, now_ns)
        elif attempt.ready.is_set():
            self._switch(attempt, now_ns)
        elif self._clock() > self._until_s:
            what = "not loaded" if attempt.detector is None else attempt.progress
            limit_s = self._perception.swap.load_timeout_s
            late = f"{what} after {limit_s:g} s (perception.swap.load_timeout_s)"
            self._refuse(attempt, late, now_ns)

    @property
    def state(self) -> str:
        """`idle`, `loading`, `checking`, `on probation`, `kept`, `rolled back` or `refused`."""
        if (attempt := self._attempt) is None:
            return self._over["state"]
        return "on probation" if attempt.switched else attempt.stage

    def status(self) -> dict[str, object]:
        """The swap under way, or the outcome of the last one; JSON-ready.

        `detail` is a line that changes with the state, `progress` changes more often, and
        `number` counts the swaps since the start.
        """
        if (attempt := self._attempt) is None:
            return {**self._over, "progress": "", "number": self._number}
        return {
            "state": self.state,
            "model": attempt.model,
            "previous": attempt.previous.name,
            "detail": attempt.finding if attempt.switched else attempt.busy,
            "progress": attempt.progress,
            "number": self._number,
        }

    def close(self) -> None:
        """The worker's detector stays; whatever else is open is closed.

        A model that takes longer than `_CLOSE_S` to load is left to its thread; the process must
        then end without the interpreter's clearing up (see `edge.cli.main`).
        """
        if (attempt := self._attempt) is not None:
            self._end(attempt, attempt.previous if attempt.switched else None)
        until_s = time.monotonic() + _CLOSE_S
        for thread in self._closing:
            thread.join(max(0.0, until_s - time.monotonic()))
        if any(thread.is_alive() for thread in self._closing):
            log.warning("a model is still being loaded: not waited for")

    def _switch(self, attempt: Attempt, now_ns: int) -> None:
        if attempt.detector.prompts != self._worker.detector.prompts:
            attempt.adapt()
            return
        attempt.switch()
        self._worker.spare = self._worker.exchange(attempt.detector)
        n = self._perception.swap.probation
        self._tell(
            f"model {attempt.model}: switched to, on probation for {n} images; {attempt.finding}",
            now_ns,
        )

    def _watch(self, attempt: Attempt, now_ns: int) -> None:
        verdict = attempt.verdict()
        if attempt.fault:
            self._worker.exchange(attempt.previous)
            why = f"{attempt.fault}; {attempt.previous.name} runs again"
            self._conclude(attempt, "rolled back", why, None, now_ns)
        elif verdict is not None:
            self._conclude(attempt, "kept", verdict, attempt.previous, now_ns)

    def _refuse(self, attempt: Attempt, reason: str, now_ns: int) -> None:
        why = f"{reason}; {attempt.previous.name} goes on"
        self._conclude(attempt, "refused", why, None, now_ns)

    def _conclude(
        self, attempt: Attempt, state: str, detail: str, loser: Detector | None, now_ns: int
    ) -> None:
        self._end(attempt, loser)
        self._over = {
            "state": state, "model": attempt.model, "previous": attempt.previous.name,
            "detail": detail,
        }  # fmt: skip
        self._tell(f"model {attempt.model}: {state}: {detail}", now_ns)

    def _end(self, attempt: Attempt, loser: Detector | None) -> None:
        """No swap is under way any more; the detector that lost (None: the new one) is closed."""
        self._attempt = self._worker.watch = self._worker.spare = None
        self._closing = [t for t in self._closing if t.is_alive()]
        abandoned = attempt.at_work
        letting_go = attempt.give_up(loser)
        self._closing.append(letting_go)
        if abandoned:
            self._late = attempt.model, letting_go
