"""Swap of a model in the running service, in steps that never block the loop.

A thread loads and tries the new model while the old one keeps running. After the switch the new
model is on probation, and the old one stays open. `ModelSwap.step` only checks if the next step is
due. A swap that fails at any point leaves the old model running, and logs one line.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic

from edge.errors import UserError
from edge.host.interruptible import start_detached_thread
from edge.host.worker import LONGEST_ERROR
from edge.perception.swap.trial import failure
from edge.perception.worker import Item, Model, ModelWorker
from edge.text import one_line

log = logging.getLogger(__name__)

FINAL_STATES = ("kept", "rolled back", "refused")  # outcomes of a swap
LOAD_TIMEOUT_S = 600.0  # limit for loading and trial; then the swap is refused
POLL_S = 0.02  # polling period of an attempt's thread
CLOSE_S = 5.0  # longest wait of `ModelSwap.close` for the threads of ended attempts

LogCallback = Callable[[str, int, int], object]
"""Called with a line, the loop's time in ns, and the log level."""


class SwapError(UserError):
    """The reason why no swap was begun; one line."""


class SwapAttempt(ABC, Generic[Model, Item]):
    """One model that is to replace a worker's model.

    Its own thread loads and tries the model, and at the end closes the model that lost. The
    worker's thread calls `on_result`; the caller of `ModelSwap.step` calls the other methods.

    Attributes:
        previous: the model that runs when the attempt begins.
        model: the new model; None until it is loaded.
        load_progress: progress of a slow load (an engine build), in one line; empty otherwise.
        finding: result of the trial, in one line; empty before it.
        trying: True while the model is loaded or tried.
        switched: True once the model runs, on probation.
        fault: the reason to reject the model, in one line; empty if there is none.
        decided: set once it is decided which of the two models stays.
    """

    def __init__(self, name: str, worker: ModelWorker[Any, Any, Model]) -> None:
        self.name, self._worker = name, worker
        self.previous: Model = worker.model
        self.model: Model | None = None
        self.load_progress = self.finding = self.fault = ""
        self.trying, self.switched, self._new_model_won = True, False, False
        self.decided = threading.Event()

    def start(self) -> None:
        """Load and try the model, on the attempt's thread."""
        self._worker.on_result = self.on_result
        self.thread = start_detached_thread("swap", self._run)

    @abstractmethod
    def on_result(self, model: Model, item: Item, outcome: object) -> None:
        """Record the outcome of an item; see `ModelWorker.on_result`."""

    @abstractmethod
    def verdict(self, idle: bool) -> str:
        """Return the result of the probation, or "" while it lasts.

        If the model fails the probation, set `fault`; the returned text then does not count.

        Args:
            idle: True: no more items will come, so the probation would never end.
        """

    @property
    @abstractmethod
    def progress(self) -> str:
        """Progress for a person; may change with every item."""

    @property
    @abstractmethod
    def probation(self) -> str:
        """Length of the probation, for a person."""

    @abstractmethod
    def _try(self) -> None:
        """Load and set `model`, try it, and set `finding`; on the attempt's thread.

        Raises:
            Exception: the reason to reject the model.
        """

    def status(self) -> dict[str, object]:
        before = "loading" if self.model is None else "checking"
        return {
            "state": "on probation" if self.switched else before,
            "model": self.name,
            "previous": self.previous.name,
            "detail": self.finding if self.switched else self.load_progress,
            "progress": self.progress,
        }

    def switch(self) -> bool:
        """Run the model if its trial has passed; return True if it now runs."""
        if not self.finding:
            return False
        self.switched = True
        self._worker.exchange(self.model)
        return True

    def end(self) -> None:
        """Close the model that does not run, on the attempt's thread: the swap is decided."""
        self._new_model_won = self._worker.model is self.model
        self._worker.on_result = None
        self.decided.set()

    def _run(self) -> None:
        """Run the attempt's thread, which ends once the model that lost is closed."""
        try:
            self._try()
        except UserError as error:
            self.fault = one_line(error, LONGEST_ERROR)
        except Exception as error:  # loading a model may raise anything
            log.debug("model %s", self.name, exc_info=True)
            self.fault = failure(error)
        self.trying = False
        self.decided.wait()
        loser = self.previous if self._new_model_won else self.model
        self.previous = self.model = None
        if loser is None:
            return
        while self._worker.uses(loser):
            time.sleep(POLL_S)
        loser.close()


class ModelSwap(Generic[Model]):
    """Replaces a worker's model; all methods must be called from one thread, the loop's.

    Attributes:
        outcomes: number of swaps since the start, by outcome (`FINAL_STATES`).
    """

    def __init__(
        self,
        worker: ModelWorker[Any, Any, Model],
        report: LogCallback,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._worker, self._report, self._clock = worker, report, clock
        self._attempt: SwapAttempt[Model, Any] | None = None
        self._ended: list[SwapAttempt[Model, Any]] = []  # their threads may still run
        self._load_deadline_s = 0.0
        self.number = 0
        self.outcomes = dict.fromkeys(FINAL_STATES, 0)
        self._last_status = {"state": "idle", "model": self.running, "previous": "", "detail": ""}

    @property
    def running(self) -> str:
        """Name of the model that runs."""
        return self._worker.model.name

    @property
    def state(self) -> str:
        """`idle`, `loading`, `checking`, `on probation`, `kept`, `rolled back` or `refused`."""
        return str(self.status()["state"])

    def status(self) -> dict[str, object]:
        """Return the state of the current swap, or the outcome of the last one; JSON-ready.

        `detail` is a line that changes with the state. `progress` changes more often. `number` is
        the attribute.
        """
        status = self._last_status if self._attempt is None else self._attempt.status()
        return {"progress": "", **status, "number": self.number}

    def step(self, now_ns: int = 0, *, idle: bool = False) -> None:
        """Do the next step of the swap if it is due; never block.

        The service calls it inside a tick for choice models; the runner calls it between two ticks
        for detectors.
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
            line = f"runs now, on probation for {attempt.probation}; {attempt.finding}"
            self._report(f"model {attempt.name}: {line}", now_ns, logging.INFO)
        elif fault := attempt.fault or self._timeout_reason(attempt):
            self._end(attempt, "refused", f"{fault}; {previous.name} goes on", now_ns)

    def close(self) -> None:
        """Close every model except the worker's own.

        A model that takes longer than `CLOSE_S` to load is left to its thread; the process must
        then end without the interpreter's clean-up (see `edge.cli.main`).
        """
        if self._attempt is not None:
            self._finish(self._attempt)
        until_s = time.monotonic() + CLOSE_S
        for ended in self._ended:
            ended.thread.join(max(0.0, until_s - time.monotonic()))
        if any(ended.thread.is_alive() for ended in self._ended):
            log.warning(
                "a model of a swap is still loading: the service ends without waiting for it"
            )

    def _check_free(self, name: str, again: bool = False) -> None:
        """Check that a swap to a model may begin.

        Args:
            name: of the model.
            again: True: the model may be the running one, to be loaded again.

        Raises:
            SwapError: the model runs already, another swap is running, or a refused model is
                still loading: a third model would not fit in memory.
        """
        if self._attempt is not None:
            raise SwapError(
                f"the swap to {self._attempt.name} is still {self.state}; wait until it ends"
            )
        if name == self.running and not again:
            raise SwapError(f"model {name} runs already")
        if loading := next((ended.name for ended in self._ended if ended.trying), None):
            raise SwapError(
                f"model {loading}, which was refused, is still loading; try again later"
            )

    def _begin(self, attempt: SwapAttempt[Model, Any], now_ns: int) -> None:
        """Start an attempt; the caller has called `_check_free`."""
        self.number += 1
        self._attempt = attempt
        self._load_deadline_s = self._clock() + LOAD_TIMEOUT_S
        attempt.start()
        self._report(f"model {attempt.name}: loading, {self.running} runs", now_ns, logging.INFO)

    def _timeout_reason(self, attempt: SwapAttempt[Model, Any]) -> str:
        """Return the reason to stop waiting for the model; "" if there is none yet."""
        if self._clock() <= self._load_deadline_s:
            return ""
        reached = attempt.progress or ("not loaded" if attempt.model is None else "not ready")
        return f"{reached} after {LOAD_TIMEOUT_S:g} s"

    def _end(self, attempt: SwapAttempt[Model, Any], state: str, detail: str, now_ns: int) -> None:
        """Record and report the outcome of an attempt (`FINAL_STATES`), and finish it."""
        self.outcomes[state] += 1
        self._last_status = {
            "state": state, "model": attempt.name, "previous": attempt.previous.name,
            "detail": detail,
        }  # fmt: skip
        self._finish(attempt)
        level = logging.INFO if state == "kept" else logging.WARNING
        self._report(f"model {attempt.name}: {state}: {detail}", now_ns, level)

    def _finish(self, attempt: SwapAttempt[Model, Any]) -> None:
        """End the attempt; its thread closes the model that does not run."""
        self._attempt = None
        self._ended = [ended for ended in self._ended if ended.thread.is_alive()] + [attempt]
        attempt.end()
