"""Another model in the running service: loaded beside it, tried, switched to, kept or not.

The running model goes on until the new one was tried, and is kept, open, until the new one has
proved itself at work. Loading and trying happen on a thread; the loop only looks, once a tick,
whether it is time for the next step. A swap that fails at any point leaves the model that ran
before, and one line.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic

from edge.errors import UserError
from edge.host.interruptible import start_unjoined
from edge.host.worker import LONGEST_ERROR
from edge.perception.swap.trial import failure
from edge.perception.worker import Item, Model, ModelWorker
from edge.text import one_line

log = logging.getLogger(__name__)

OVER = ("kept", "rolled back", "refused")
LOAD_TIMEOUT_S = 600.0
LOOK_S = 0.02  # between two looks of the thread at what it waits for
CLOSE_S = 5.0

Tell = Callable[[str, int, int], object]
"""Called with a line, the loop's time and the log's level."""


class SwapError(UserError):
    """Why no swap was begun; one line."""


class Attempt(ABC, Generic[Model, Item]):
    """One model that is to take the place of a worker's.

    Its own thread loads and tries the model and closes the loser. The worker's thread calls
    `see`, the loop's the other methods.

    Attributes:
        name: of the new model.
        previous: the model that runs when the attempt begins.
        model: the new one, once it is loaded.
        busy: what loading takes its time with, in one line; empty when it is nothing special.
        finding: what the trial found, in one line; empty before.
        trying: it is being loaded or tried.
        switched: it was put to work, on probation.
        fault: why it cannot stay, in one line; empty while nothing speaks against it.
        over: set once it is decided which of the two stays.
    """

    def __init__(self, name: str, worker: ModelWorker[Any, Any, Model]) -> None:
        self.name, self._worker = name, worker
        self.previous: Model = worker.model
        self.model: Model | None = None
        self.busy = self.finding = self.fault = ""
        self.trying, self.switched, self._won = True, False, False
        self.over = threading.Event()

    def start(self) -> None:
        """Load and try the model, on the attempt's thread."""
        self._worker.watch = self.see
        self.thread = start_unjoined("swap", self._run)

    @abstractmethod
    def see(self, model: Model, item: Item, outcome: object) -> None:
        """Take note of what came of an item; see `ModelWorker.watch`."""

    @abstractmethod
    def verdict(self, idle: bool) -> str:
        """Return how the model did on probation, empty until that is over; set `fault` where it
        did badly.

        Args:
            idle: nothing is asked for any more, so probation would never end.
        """

    @property
    @abstractmethod
    def progress(self) -> str:
        """How far it is, for a person; may change with every item."""

    @property
    @abstractmethod
    def probation(self) -> str:
        """How long probation lasts, for a person."""

    @abstractmethod
    def _try(self) -> None:
        """Load the model and set `model`, try it and set `finding`; on the attempt's thread.

        Raises:
            what keeps the model from being switched to.
        """

    def status(self) -> dict[str, object]:
        """See `Swap.status`."""
        before = "loading" if self.model is None else "checking"
        return {
            "state": "on probation" if self.switched else before,
            "model": self.name,
            "previous": self.previous.name,
            "detail": self.finding if self.switched else self.busy,
            "progress": self.progress,
        }

    def switch(self) -> bool:
        """Put the model to work if it was tried; return whether that was done."""
        if not self.finding:
            return False
        self.switched = True
        self._worker.exchange(self.model)
        return True

    def end(self) -> None:
        """Have the thread close the model that is not at work: it is decided."""
        self._won = self._worker.model is self.model
        self._worker.watch = None
        self.over.set()

    def _run(self) -> None:
        """The thread: ends with the loser closed."""
        try:
            self._try()
        except UserError as error:
            self.fault = one_line(error, LONGEST_ERROR)
        except Exception as error:  # whatever loading a model may raise
            log.debug("model %s", self.name, exc_info=True)
            self.fault = failure(error)
        self.trying = False
        self.over.wait()
        loser = self.previous if self._won else self.model
        self.previous = self.model = None
        if loser is None:
            return
        while self._worker.uses(loser):
            time.sleep(LOOK_S)
        loser.close()


class Swap(Generic[Model]):
    """Swaps a worker's model; all methods are for the loop's thread.

    Args:
        tell: called with a line for everything that happens.
        clock: seconds, for `LOAD_TIMEOUT_S`.

    Attributes:
        outcomes: how many swaps ended how (`OVER`), since the start.
        number: how many were begun.
    """

    def __init__(
        self,
        worker: ModelWorker[Any, Any, Model],
        tell: Tell,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._worker, self._tell, self._clock = worker, tell, clock
        self._attempt: Attempt[Model, Any] | None = None
        self._ended: list[Attempt[Model, Any]] = []
        self._until_s = 0.0
        self.number = 0
        self.outcomes = dict.fromkeys(OVER, 0)
        self._over = {"state": "idle", "model": self.running, "previous": "", "detail": ""}

    @property
    def running(self) -> str:
        """Name of the model at work."""
        return self._worker.model.name

    @property
    def state(self) -> str:
        """`idle`, `loading`, `checking`, `on probation`, `kept`, `rolled back` or `refused`."""
        return str(self.status()["state"])

    def status(self) -> dict[str, object]:
        """The swap under way, or the outcome of the last one; JSON-ready.

        `detail` is a line that changes with the state, `progress` changes more often, and
        `number` is the attribute.
        """
        told = self._over if self._attempt is None else self._attempt.status()
        return {"progress": "", **told, "number": self.number}

    def step(self, now_ns: int = 0, *, idle: bool = False) -> None:
        """Take the next step if it is due, without waiting.

        Args:
            idle: see `Attempt.verdict`.
        """
        attempt = self._attempt
        if attempt is None:
            return
        previous = attempt.previous
        if attempt.switched:
            verdict = attempt.verdict(idle)
            if attempt.fault:
                self._worker.exchange(previous)
                why = f"{attempt.fault}; {previous.name} runs again"
                self._end(attempt, "rolled back", why, now_ns)
            elif verdict:
                self._end(attempt, "kept", verdict, now_ns)
        elif not attempt.fault and attempt.switch():
            line = f"switched to, on probation for {attempt.probation}; {attempt.finding}"
            self._tell(f"model {attempt.name}: {line}", now_ns, logging.INFO)
        elif fault := attempt.fault or self._overdue(attempt):
            self._end(attempt, "refused", f"{fault}; {previous.name} goes on", now_ns)

    def close(self) -> None:
        """Close whatever is open but the worker's own model.

        A model that takes longer than `CLOSE_S` to load is left to its thread; the process must
        then end without the interpreter's clearing up (see `edge.cli.main`).
        """
        if self._attempt is not None:
            self._let_go(self._attempt)
        until_s = time.monotonic() + CLOSE_S
        for ended in self._ended:
            ended.thread.join(max(0.0, until_s - time.monotonic()))
        if any(ended.thread.is_alive() for ended in self._ended):
            log.warning("a model is still being loaded: not waited for")

    def _check_free(self, name: str, again: bool = False) -> None:
        """Check that a swap to a model may begin.

        Args:
            again: it may be the one that runs, made anew.

        Raises:
            SwapError: it runs already, another swap is under way, or a model that was refused
                is still being loaded and would be a third one in memory.
        """
        if self._attempt is not None:
            raise SwapError(f"{self._attempt.name} is still {self.state}; wait until that is over")
        if name == self.running and not again:
            raise SwapError(f"{name} runs already")
        if late := next((one.name for one in self._ended if one.trying), None):
            raise SwapError(f"{late}, which was refused, is still being loaded; try again later")

    def _begin(self, attempt: Attempt[Model, Any], now_ns: int) -> None:
        self.number += 1
        self._attempt = attempt
        self._until_s = self._clock() + LOAD_TIMEOUT_S
        attempt.start()
        self._tell(f"model {attempt.name}: loading beside {self.running}", now_ns, logging.INFO)

    def _overdue(self, attempt: Attempt[Model, Any]) -> str:
        """Why a model is not waited for any longer; empty while it is."""
        if self._clock() <= self._until_s:
            return ""
        what = attempt.progress or ("not loaded" if attempt.model is None else "not ready")
        return f"{what} after {LOAD_TIMEOUT_S:g} s"

    def _end(self, attempt: Attempt[Model, Any], state: str, detail: str, now_ns: int) -> None:
        self.outcomes[state] += 1
        self._over = {
            "state": state, "model": attempt.name, "previous": attempt.previous.name,
            "detail": detail,
        }  # fmt: skip
        self._let_go(attempt)
        level = logging.INFO if state == "kept" else logging.WARNING
        self._tell(f"model {attempt.name}: {state}: {detail}", now_ns, level)

    def _let_go(self, attempt: Attempt[Model, Any]) -> None:
        """No swap is under way any more; the model that is not at work is closed."""
        self._attempt = None
        self._ended = [one for one in self._ended if one.thread.is_alive()] + [attempt]
        attempt.end()
