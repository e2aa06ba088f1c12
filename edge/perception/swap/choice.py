"""Swap of the model for VLM frontier selection; see `base`.

A model that loads must answer one question first. After the switch it is kept when it has answered
`PROBATION` questions, or when no mission runs that has questions.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from edge.errors import UserError
from edge.perception.swap.base import ModelSwap, SwapAttempt
from edge.perception.swap.trial import failure
from edge.perception.worker import Question, Scorer, ScorerWorker
from edge.text import one_line

log = logging.getLogger(__name__)

CARD_KEY = "perception.choice.card"
PROBATION = 3
"""Number of questions. Enough to show that the model accepts the mission's targets and images."""

Make = Callable[[str], Scorer]
"""Makes the scorer of a card, which may take minutes."""


def _log(text: str, now_ns: int, level: int) -> None:
    log.log(level, "%s", text)


class ChoiceSwap(ModelSwap[Scorer]):
    """Replaces the choice model of a worker (the scorer of VLM frontier selection)."""

    def __init__(self, worker: ScorerWorker[Any, Any], make: Make) -> None:
        super().__init__(worker, _log)
        self._make = make

    def request(self, card: str) -> None:
        """Begin to swap a model in.

        Raises:
            SwapError: the model runs already, another swap is running, or a refused model is
                still loading.
        """
        self._check_free(card)
        now_ns = 0  # `_log` does not use the time
        self._begin(_ChoiceAttempt(card, self._worker, self._make), now_ns)

    def status(self) -> dict[str, object]:
        """See `ModelSwap.status`; `key` is the configuration key that makes the swap permanent."""
        return {**super().status(), "key": CARD_KEY}


class _ChoiceAttempt(SwapAttempt[Scorer, Question]):
    """One choice model that is to replace the worker's; see `SwapAttempt`."""

    def __init__(self, card: str, worker: ScorerWorker[Any, Any], make: Make) -> None:
        super().__init__(card, worker)
        self._make, self._answers = make, 0

    @property
    def progress(self) -> str:
        return f"{self._answers} of {PROBATION} answers" if self.switched else ""

    @property
    def probation(self) -> str:
        return f"{PROBATION} answers"

    def on_result(self, model: Scorer, item: Question, outcome: object) -> None:
        """Count an answer of the new model, or record its fault; see `SwapAttempt`."""
        if model is not self.model:
            return
        if not isinstance(outcome, Exception):
            self._answers += outcome is not None
        elif item.observation.rgb is not None:  # a missing image is not the model's fault
            is_user_error = isinstance(outcome, UserError)
            reason = one_line(outcome, 500) if is_user_error else failure(outcome)
            self.fault = self.fault or reason

    def verdict(self, idle: bool) -> str:
        """Return why the model is kept; "" while that is open, or after a fault."""
        passed = self._answers >= PROBATION
        if self.fault or not (passed or idle):
            return ""
        short = "" if passed else ", and no mission runs that needs more"
        return f"{self._answers} answers{short}; {self.finding}"

    def _try(self) -> None:
        """See `SwapAttempt`; opening a scorer asks it a first question."""
        begin_s = time.monotonic()
        self.model = self._make(self.name)
        self.finding = f"loaded and asked in {time.monotonic() - begin_s:.1f} s"
