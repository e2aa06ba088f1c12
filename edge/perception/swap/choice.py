"""Another model that chooses directions in the running service: loaded beside, then switched to.

It was asked once when it was loaded; from the next question on it is asked, and the one before is
kept, open, until it has answered `PROBATION` of them, or no mission is left to ask. A swap that
fails at any point leaves the model that ran before, and one line.
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
from edge.perception.swap.trial import failure
from edge.perception.worker import Question, Scorer, ScorerWorker
from edge.text import one_line

log = logging.getLogger(__name__)

CARD_KEY = "perception.choice.card"
PROBATION = 3
"""Questions: enough to see that it knows the mission's targets and is shown what it can take."""
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
            raise SwapError(
                f"{self._attempt.model} is still {self._state}; wait until that is over"
            )
        if model == self._worker.name:
            raise SwapError(f"{model} runs already")
        self.number += 1
        self._state, self._detail = "loading", ""
        self._model, self._previous = model, self._worker.name
        self._attempt = _Attempt(model, self._make, self._worker)
        log.info("model %s: loading beside %s", model, self._previous)

    def step(self, idle: bool = False) -> None:
        """Take the next step if it is time for one: between two questions, and never waiting.

        Args:
            idle: no mission asks questions. Probation would never end, so it ends now.
        """
        attempt = self._attempt
        if attempt is None or not attempt.loaded.is_set():
            return
        if attempt.displaced is None:
            if attempt.fault:
                self._end("refused", f"{attempt.fault}; {self._previous} goes on")
            else:
                attempt.switch()
                self._say("on probation", attempt.finding)
        elif attempt.fault:
            self._worker.exchange(attempt.displaced)
            self._end("rolled back", f"{attempt.fault}; {self._previous} runs again", won=False)
        elif attempt.answers >= PROBATION or idle:
            short = "" if attempt.answers >= PROBATION else ", and no mission to ask more for"
            self._end("kept", f"{attempt.answers} answers{short}; {attempt.finding}")

    def status(self) -> dict[str, object]:
        """The swap under way, or the outcome of the last one; JSON-ready, as
        `edge.perception.swap.swapper.Swapper.status`; `key` would make it lasting."""
        trying = self._attempt is not None and self._attempt.displaced is not None
        progress = f"{self._attempt.answers} of {PROBATION} answers" if trying else ""
        return {
            "state": self._state, "model": self._model, "previous": self._previous,
            "detail": self._detail, "progress": progress, "number": self.number, "key": CARD_KEY,
        }  # fmt: skip

    def close(self) -> None:
        """What is being loaded is closed once it is loaded; nobody waits for that."""
        self._let_go()

    def _say(self, state: str, detail: str) -> None:
        self._state, self._detail = state, detail
        log.info("model %s: %s: %s", self._model, state, detail)

    def _end(self, state: str, detail: str, won: bool = True) -> None:
        self._say(state, detail)
        self._let_go(won)

    def _let_go(self, won: bool = True) -> None:
        """No swap is under way any more; the scorer that is not asked is closed.

        Args:
            won: the new one stays, if it was switched to.
        """
        if self._attempt is not None:
            self._worker.watch = None
            self._attempt.end(won)
        self._attempt = None


class _Attempt:
    """One model that is to take the place of a worker's scorer, and the thread that loads it.

    The worker's thread calls `see`, the loop's the other methods.

    Attributes:
        scorer: once it is loaded.
        displaced: what it took the place of; None: it has not.
        answers: that it gave since then.
        finding: how it was loaded, in one line.
        fault: why it cannot stay, in one line; empty while nothing speaks against it.
        loaded: it is, or it never will be.
    """

    def __init__(self, model: str, make: Make, worker: ScorerWorker[Any, Any]) -> None:
        self.model, self.fault, self.finding, self.answers = model, "", "", 0
        self.scorer: Scorer[Any, Any] | None = None
        self.displaced: Scorer[Any, Any] | None = None
        self.loaded, self._over = threading.Event(), threading.Event()
        self._make, self._worker, self._won = make, worker, False
        start_unjoined("swap", self._run)

    def switch(self) -> None:
        """Have it asked from the next question on."""
        self._worker.watch = self.see
        self.displaced = self._worker.exchange(self.scorer)

    def see(self, scorer: Scorer[Any, Any], question: Question, outcome: object) -> None:
        """For `ScorerWorker.watch`: one question of its probation."""
        if scorer is not self.scorer:
            return
        if not isinstance(outcome, Exception):
            self.answers += outcome is not None
        elif question.observation.rgb is not None:  # no image is no model's fault
            self.fault = self.fault or _reason(outcome)

    def end(self, won: bool) -> None:
        """It is decided which of the two stays: the other is closed, by the thread."""
        self._won = won and self.displaced is not None
        self._over.set()

    def _run(self) -> None:
        begin_s = time.monotonic()
        try:
            self.scorer = self._make(self.model)
        except Exception as error:  # whatever loading a model may raise
            log.debug("model %s", self.model, exc_info=True)
            self.fault = _reason(error)
        self.finding = f"loaded and asked in {time.monotonic() - begin_s:.1f} s"
        self.loaded.set()
        self._over.wait()
        loser = self.displaced if self._won else self.scorer
        self.scorer = self.displaced = None
        if loser is None:
            return
        while self._worker.uses(loser):
            time.sleep(_LOOK_S)
        loser.close()


def _reason(error: Exception) -> str:
    return one_line(error, 500) if isinstance(error, UserError) else failure(error)
