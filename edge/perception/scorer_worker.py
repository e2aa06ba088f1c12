"""A scorer's own thread: one question at a time, nobody waits."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any, Generic, Protocol, TypeVar

from edge.errors import UserError
from edge.perception.worker import LONGEST_ERROR
from edge.text import one_line
from edge.types import Observation

log = logging.getLogger(__name__)

PAUSE_S, MAX_PAUSE_S = 1.0, 30.0
MAX_DOUBLINGS = 6


class Question(Protocol):
    """What a scorer is asked; its observation is held until the scorer has looked at it."""

    @property
    def observation(self) -> Observation: ...


Q = TypeVar("Q", bound=Question)
A = TypeVar("A")


class Scorer(Protocol[Q, A]):
    """A model beside the loop, in two steps so that a frame is not held while a server thinks.

    Attributes:
        name: what it is, for people.
    """

    name: str

    def look(self, question: Q) -> Any:
        """Everything that needs the observation's arrays; may raise anything."""
        ...

    def answer(self, looked: Any) -> A | None:
        """The rest, which may take long but not for ever; may raise anything."""
        ...

    def close(self) -> None:
        """Give up at once, if that can be, what is being answered in another thread."""
        ...


@dataclass(slots=True)
class ScorerStats:
    """Counts since the start; written by the worker, read by anyone.

    Attributes:
        failed: questions without an answer; `in_a_row` of them were the last ones.
        last_latency_ns: of the newest answer, from question to answer.
        last_error: the newest failure in words, empty when there was none.
    """

    asked: int = 0
    answered: int = 0
    failed: int = 0
    in_a_row: int = 0
    last_latency_ns: int = 0
    last_error: str = ""


class ScorerWorker(Generic[Q, A]):
    """Runs a scorer beside the loop, which submits the newest question when the worker is idle.

    After a failure it stays busy for a while, twice as long each time: a server that refuses at
    once must not be asked at the loop's rate.

    Args:
        kind: what the scorer is for, in messages.
        rest_s: how long it stays busy after an answer, too.
        pause_s: how long after the first failure.
    """

    def __init__(
        self, kind: str, scorer: Scorer[Q, A], rest_s: float = 0.0, pause_s: float = PAUSE_S
    ) -> None:
        self.name = scorer.name
        self.stats = ScorerStats()
        self._kind, self._scorer, self._rest_s, self._pause_s = kind, scorer, rest_s, pause_s
        self._wake = threading.Condition()
        self._question: Q | None = None
        self._result: A | None = None
        self._idle = True
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=kind, daemon=True)
        self._thread.start()

    @property
    def idle(self) -> bool:
        """Whether the next question would be taken."""
        return self._idle

    def submit(self, question: Q) -> bool:
        """Answer this, unless another is being answered. Never blocks.

        Returns:
            Whether it is taken. Its observation is then held as long as need be.
        """
        with self._wake:
            if self._closed or not self._idle:
                return False
            question.observation.hold()
            self._question, self._idle = question, False
            self.stats.asked += 1
            self._wake.notify_all()
        return True

    def poll(self) -> A | None:
        """The newest answer that was not polled yet, or None."""
        if self._result is None:  # as in nearly every tick
            return None
        with self._wake:
            result, self._result = self._result, None
        return result

    def close(self) -> None:
        """Give up what is being answered and stop the thread."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()
        self._scorer.close()
        self._thread.join()
        if self._question is not None:
            self._question.observation.release()
            self._question = None

    def _run(self) -> None:
        while (question := self._next()) is not None:
            begin_ns = perf_counter_ns()
            try:
                outcome = _put_to(self._scorer, question)
            except Exception as error:  # the loop must outlive whatever a model does
                outcome = error
            with self._wake:
                if self._closed:
                    return
                took_ns = perf_counter_ns() - begin_ns
                went_well = _count(self.stats, outcome, took_ns, self._kind)
                if went_well:
                    self._result = outcome
                rest_s = self._rest_s if went_well else self._pause()
                self._wake.wait_for(lambda: self._closed, rest_s)
                self._idle = True

    def _next(self) -> Q | None:
        with self._wake:
            self._wake.wait_for(lambda: self._question is not None or self._closed)
            if self._closed:
                return None
            question, self._question = self._question, None
            return question

    def _pause(self) -> float:
        doubled = min(self.stats.in_a_row - 1, MAX_DOUBLINGS)
        return min(self._pause_s * 2.0**doubled, MAX_PAUSE_S)


class InlineScorer(Generic[Q, A]):
    """Has the methods of `ScorerWorker`, but `submit` answers at once, so that a run replays.

    After a failure it takes no question for a while, which it counts in questions. Time does not
    pass for it, so that it needs no rest.
    """

    def __init__(self, kind: str, scorer: Scorer[Q, A], rest_s: float = 0.0) -> None:
        self.name = scorer.name
        self.stats = ScorerStats()
        self._kind, self._scorer = kind, scorer
        self._result: A | None = None
        self._skips = 0

    @property
    def idle(self) -> bool:
        return True

    def submit(self, question: Q) -> bool:
        """Answer this now, unless it is to be skipped."""
        if self._skips > 0:
            self._skips -= 1
            return False
        self.stats.asked += 1
        begin_ns = perf_counter_ns()
        question.observation.hold()
        try:
            outcome = _put_to(self._scorer, question)
        except Exception as error:  # as in `ScorerWorker`
            outcome = error
        if _count(self.stats, outcome, perf_counter_ns() - begin_ns, self._kind):
            self._result = outcome
        else:
            self._skips = 2 ** min(self.stats.in_a_row, MAX_DOUBLINGS)
        return True

    def poll(self) -> A | None:
        """The answer to the last `submit`, once."""
        result, self._result = self._result, None
        return result

    def close(self) -> None:
        self._scorer.close()


def _put_to(scorer: Scorer[Q, A], question: Q) -> A | None:
    """The scorer's answer to a question, whose observation is let go as soon as can be."""
    try:
        looked = scorer.look(question)
    finally:
        question.observation.release()
    return scorer.answer(looked)


def _count(stats: ScorerStats, outcome: Any, took_ns: int, kind: str) -> bool:
    """Write down how it went, and say so when it begins to go wrong; whether it went well."""
    if not isinstance(outcome, Exception):
        stats.in_a_row = 0
        stats.answered += 1
        stats.last_latency_ns = took_ns
        return True
    stats.failed += 1
    stats.in_a_row += 1
    known = isinstance(outcome, UserError)
    text = str(outcome) if known else f"{type(outcome).__name__}: {outcome}"
    stats.last_error = one_line(text, LONGEST_ERROR)
    if stats.in_a_row == 1:
        log.error("%s: %s (until it goes well again, this is only counted)",
                  kind, stats.last_error)  # fmt: skip
    return False
