"""Another model that chooses directions in the running service: loaded beside, then switched to.

It was asked both questions when it was loaded, so there is nothing left to be tried: from the next
question on it is asked. What fails leaves the one that ran before, and one line.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from edge.errors import UserError
from edge.host.interruptible import start_unjoined
from edge.perception.swap.swapper import SwapError
from edge.perception.worker import Scorer, ScorerWorker
from edge.text import one_line

log = logging.getLogger(__name__)

CARD_KEY = "perception.choice.card"
_LOOK_S = 0.02

Make = Callable[[str], Scorer]
"""Makes the scorer of a card, which may take minutes."""


class ChoiceSwap:
    """Swaps a worker's scorer; `request`, `step` and `close` are for the loop's thread.

    Attributes:
        number: of the newest swap, from 1; 0 before the first.
    """

    def __init__(self, worker: ScorerWorker[Any, Any], make: Make) -> None:
        self.number = 0
        self._worker, self._make = worker, make
        self._attempt: _Attempt | None = None
        self._state, self._detail = "idle", ""
        self._model, self._previous = worker.name, ""

    def request(self, model: str) -> None:
        """Begin to swap a model in.

        Raises:
            SwapError: it runs already, or another swap is under way.
        """
        if self._attempt is not None:
            raise SwapError(f"{self._attempt.model} is still loading; wait until that is over")
        if model == self._worker.name:
            raise SwapError(f"{model} runs already")
        self.number += 1
        self._state, self._detail = "loading", ""
        self._model, self._previous = model, self._worker.name
        self._attempt = _Attempt(model, self._make, self._worker)
        log.info("model %s: loading beside %s", model, self._previous)

    def step(self) -> None:
        """Take the next step if it is time for one: between two questions, and never waiting."""
        attempt = self._attempt
        if attempt is None or not attempt.loaded.is_set():
            return
        if attempt.fault:
            self._state, self._detail = "refused", f"{attempt.fault}; {self._previous} goes on"
        else:
            attempt.displaced = self._worker.exchange(attempt.scorer)
            self._state, self._detail = "kept", f"loaded and asked in {attempt.took_s:.1f} s"
        log.info("model %s: %s: %s", self._model, self._state, self._detail)
        self._end()

    def status(self) -> dict[str, object]:
        """The swap under way, or the outcome of the last one; JSON-ready, as
        `edge.perception.swap.swapper.Swapper.status`; `key` would make it lasting."""
        return {
            "state": self._state, "model": self._model, "previous": self._previous,
            "detail": self._detail, "progress": "", "number": self.number, "key": CARD_KEY,
        }  # fmt: skip

    def close(self) -> None:
        """What is being loaded is closed once it is loaded; nobody waits for that."""
        self._end()

    def _end(self) -> None:
        if self._attempt is not None:
            self._attempt.over.set()
        self._attempt = None


class _Attempt:
    """One model that is to take the place of a worker's scorer, and the thread that loads it.

    Attributes:
        scorer: once it is loaded.
        displaced: what it took the place of; None: it has not.
        fault: why it cannot be used, in one line.
        loaded: it is, or it never will be.
    """

    def __init__(self, model: str, make: Make, worker: ScorerWorker[Any, Any]) -> None:
        self.model, self.fault, self.took_s = model, "", 0.0
        self.scorer: Scorer[Any, Any] | None = None
        self.displaced: Scorer[Any, Any] | None = None
        self.loaded, self.over = threading.Event(), threading.Event()
        self._make, self._worker = make, worker
        start_unjoined("swap", self._run)

    def _run(self) -> None:
        begin_s = time.monotonic()
        try:
            self.scorer = self._make(self.model)
        except UserError as error:
            self.fault = one_line(error, 500)
        except Exception as error:  # whatever loading a model may raise
            log.debug("model %s", self.model, exc_info=True)
            self.fault = f"it fails: {type(error).__name__}: {one_line(error, 300)}"
        self.took_s = time.monotonic() - begin_s
        self.loaded.set()
        self.over.wait()
        loser = self.displaced or self.scorer
        if loser is None:
            return
        while self._worker.uses(loser):
            time.sleep(_LOOK_S)
        loser.close()
