"""Swap of the model for VLM frontier selection; see `base`.

Loading asks the model once. After the switch it is kept once it has answered `PROBATION`
questions, or once there is no mission to ask about.
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
    """Swaps the scorer of a worker for VLM frontier selection."""

    def __init__(self, worker: ScorerWorker[Any, Any], make: Make) -> None:
        super().__init__(worker, _log)
        self._make = make

    def request(self, card: str) -> None:
        """Begin to swap a model in.

        Raises:
            SwapError: see `ModelSwap._check_free`.
        """
        self._check_free(card)
        self._begin(_ChoiceAttempt(card, self._worker, self._make), 0)

    def status(self) -> dict[str, object]:
        """See `ModelSwap.status`; `key` is the configuration key that makes the swap permanent."""
        return {**super().status(), "key": CARD_KEY}


class _ChoiceAttempt(SwapAttempt[Scorer, Question]):
    """See `SwapAttempt`."""

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
        if model is not self.model:
            return
        if not isinstance(outcome, Exception):
            self._answers += outcome is not None
        elif item.observation.rgb is not None:  # a missing image is not the model's fault
            of_ours = isinstance(outcome, UserError)
            self.fault = self.fault or (one_line(outcome, 500) if of_ours else failure(outcome))

    def verdict(self, idle: bool) -> str:
        enough = self._answers >= PROBATION
        if self.fault or not (enough or idle):
            return ""
        short = "" if enough else ", and no mission runs that needs more"
        return f"{self._answers} answers{short}; {self.finding}"

    def _try(self) -> None:
        begin_s = time.monotonic()
        self.model = self._make(self.name)
        self.finding = f"loaded and asked in {time.monotonic() - begin_s:.1f} s"
