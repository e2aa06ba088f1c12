from __future__ import annotations

import itertools
import logging
import threading
from typing import NamedTuple

import pytest
from frames import Slot
from patience import PATIENCE_S, eventually

from edge.chat import ChatError
from edge.perception.scorer_worker import MAX_DOUBLINGS, InlineScorer, ScorerWorker
from edge.types import Observation


class Question(NamedTuple):
    observation: Observation


class Fake:
    """Answers with the seq; waits for `gate` before that, until it is closed."""

    name = "fake"

    def __init__(self, *outcomes):
        self.gate = threading.Semaphore(0)
        self.under_way = self.most = self.looked = 0
        self.closed = threading.Event()
        self.outcomes = list(outcomes)

    def look(self, question):
        assert question.observation.slot.holds == 1
        self.looked += 1
        if self.outcomes and isinstance(self.outcomes[0], ValueError):
            raise self.outcomes.pop(0)
        return question.observation.seq

    def answer(self, looked):
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        while not self.gate.acquire(timeout=0.01):
            if self.closed.is_set():
                raise ChatError("given up")
        self.under_way -= 1
        outcome = self.outcomes.pop(0) if self.outcomes else looked
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def close(self):
        self.closed.set()


@pytest.fixture
def questions(make_observation):
    return [Question(make_observation(seq=i + 1, slot=Slot())) for i in range(4)]


def holds(questions):
    return [question.observation.slot.holds for question in questions]


def open_gate(fake):
    fake.gate.release(1000)
    return fake


def test_nothing_asked_nothing_said():
    worker = ScorerWorker("choice", Fake())
    assert worker.idle
    assert worker.poll() is None
    worker.close()
    worker.close()
    assert worker.stats.asked == 0


def test_one_question_at_a_time_and_its_frame_only_while_it_is_looked_at(questions):
    worker = ScorerWorker("choice", fake := Fake())
    assert worker.submit(questions[0])
    assert not worker.idle
    assert not worker.submit(questions[1])
    eventually(lambda: fake.under_way)
    assert holds(questions) == [0, 0, 0, 0]
    assert not worker.submit(questions[2])
    fake.gate.release()
    eventually(lambda: worker.idle)
    assert worker.poll() == 1
    assert worker.poll() is None
    assert worker.submit(questions[3])
    fake.gate.release()
    assert eventually(worker.poll) == 4
    worker.close()
    assert fake.most == 1
    assert (worker.stats.asked, worker.stats.answered, worker.stats.failed) == (2, 2, 0)
    assert worker.stats.last_latency_ns > 0
    assert holds(questions) == [0, 0, 0, 0]


def test_no_answer_is_no_failure(questions):
    fake = Fake()
    fake.answer = lambda looked: None
    worker = ScorerWorker("choice", fake)
    worker.submit(questions[0])
    eventually(lambda: worker.idle)
    worker.close()
    assert worker.poll() is None
    assert (worker.stats.answered, worker.stats.failed) == (1, 0)


def test_a_failure_is_one_line_and_the_next_question_waits(questions, caplog):
    """Twice as long each time, and till it goes well again nothing more is said."""
    errors = (ChatError("http://x: nothing\nlistens"), ValueError("no image"), RuntimeError("odd"))
    fake = open_gate(Fake(*errors))
    worker = ScorerWorker("choice", fake, pause_s=0.001)
    for i, last in enumerate(
        ["http://x: nothing listens", "ValueError: no image", "RuntimeError: odd"]
    ):
        eventually(lambda: worker.idle)
        assert worker.submit(questions[i])
        eventually(lambda last=last: worker.stats.last_error == last)
        assert worker._pause() == 0.001 * 2**i
    eventually(lambda: worker.idle)
    assert worker.poll() is None
    worker.submit(questions[3])
    assert eventually(worker.poll) == 4
    worker.close()
    assert (worker.stats.failed, worker.stats.answered, worker.stats.in_a_row) == (3, 1, 0)
    assert [(r.levelno, r.getMessage()) for r in caplog.records] == [
        (
            logging.ERROR,
            "choice: http://x: nothing listens (until it goes well again, this is only counted)",
        )
    ]
    assert holds(questions) == [0, 0, 0, 0]


def test_a_pause_is_bounded_and_ends_with_the_worker(questions):
    worker = ScorerWorker("choice", open_gate(Fake(RuntimeError("no"))), pause_s=1e9)
    worker.submit(questions[0])
    eventually(lambda: worker.stats.last_error)
    assert worker._pause() == 30.0
    worker.stats.in_a_row = 10**6
    assert worker._pause() == 30.0
    assert not worker.idle
    worker.close()
    assert not worker._thread.is_alive()


def test_it_rests_after_an_answer_which_is_there_at_once(questions):
    worker = ScorerWorker("choice", open_gate(Fake()), rest_s=3600)
    assert worker.submit(questions[0])
    assert eventually(worker.poll) == 1
    assert not worker.idle
    assert not worker.submit(questions[1])
    worker.close()
    assert holds(questions) == [0, 0, 0, 0]


def test_closing_gives_up_what_is_being_answered(questions, caplog):
    worker = ScorerWorker("choice", fake := Fake())
    worker.submit(questions[0])
    eventually(lambda: fake.under_way)
    worker.close()
    assert not worker._thread.is_alive()
    assert worker.poll() is None
    assert not worker.submit(questions[1])
    assert holds(questions) == [0, 0, 0, 0]
    assert not caplog.records


def test_a_question_that_was_never_looked_at_is_let_go(questions):
    worker = ScorerWorker("choice", fake := Fake())
    with worker._wake:  # so that the thread cannot take it
        assert worker.submit(questions[0])
        worker._closed = True
    worker.close()
    worker._thread.join(PATIENCE_S)
    assert fake.looked == 0
    assert holds(questions) == [0, 0, 0, 0]


def test_inline_answers_at_once(questions):
    scorer = InlineScorer("choice", open_gate(Fake()))
    assert scorer.poll() is None
    for question in questions[:2]:
        assert scorer.idle
        assert scorer.submit(question)
        assert scorer.poll() == question.observation.seq
        assert scorer.poll() is None
    assert holds(questions) == [0, 0, 0, 0]
    scorer.close()
    assert (scorer.stats.asked, scorer.stats.answered) == (2, 2)


def test_inline_skips_questions_after_a_failure(questions, caplog):
    scorer = InlineScorer("choice", fake := open_gate(Fake(*[RuntimeError("no")] * 9)))
    taken = [scorer.submit(questions[0]) for _ in range(200)]
    tried = [i for i, did in enumerate(taken) if did]
    assert tried[:4] == [0, 3, 8, 17]  # 2, 4, 8 … in between
    assert max(b - a for a, b in itertools.pairwise(tried)) == 2**MAX_DOUBLINGS + 1
    assert len(caplog.records) == 1
    while fake.outcomes:
        scorer.submit(questions[1])
    assert eventually(lambda: scorer.submit(questions[2]))
    assert scorer.stats.in_a_row == 0
    assert holds(questions) == [0, 0, 0, 0]
