"""The choice scorer with a real language model behind a real OpenAI-compatible server.

Needs what `test_edge_llm.py` needs. What so small a model makes of a view is printed, not asserted.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest
from live_patience import PATIENCE_S
from llm_process import serving_llm

from edge.chat import ChatError
from edge.config import ChoiceOpenai, ChoiceText
from edge.perception.scoring.choice.letter_scorer import LetterScorer
from edge.perception.scoring.choice.question import (
    MAX_MARKS,
    DetectedObject,
    FrontierChoice,
    Mark,
    MarkedView,
)
from edge.perception.scoring.choice.server import make_server_scorer
from edge.types import Observation

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

SEEN = (DetectedObject("bed", 0.5, 2.1), DetectedObject("lamp", 0.1, 3.0))


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving_llm() as url:
        yield url


def view(
    target: str, n_marks: int, seen: tuple[DetectedObject, ...] = SEEN, rgb=None
) -> MarkedView:
    bearings = np.linspace(0.6, -0.6, n_marks)
    marks = tuple(Mark(i, 10.0 + 30 * i, 40.0, float(b), 2.0 + i) for i, b in enumerate(bearings))
    return MarkedView(Observation(0, 0, np.eye(4), rgb=rgb), target, marks, seen)


def put_to(scorer: LetterScorer, question: MarkedView) -> FrontierChoice:
    choice = scorer.answer(scorer.prepare(question))
    assert choice is not None
    return choice


@pytest.fixture(scope="module")
def scorer(url: str) -> LetterScorer:
    return make_server_scorer(ChoiceText(url=url, model="default", time_limit_s=PATIENCE_S))


@pytest.mark.parametrize(("target", "n_marks"), [("chair", MAX_MARKS), ("tall white trash can", 1)])
def test_probabilities_over_the_letters(scorer, target, n_marks, capsys):
    choice = put_to(scorer, view(target, n_marks))
    assert choice.ids == tuple(range(n_marks))
    assert choice.p.sum() + choice.elsewhere == pytest.approx(1.0, abs=1e-5)
    assert (choice.p > 0).all()
    assert 0.0 < choice.scene < 1.0
    assert (choice.value < choice.p).all()
    again = put_to(scorer, view(target, n_marks))
    # A prompt that is kept is computed in other batches than a new one.
    np.testing.assert_allclose(again.p, choice.p, atol=0.05)
    with capsys.disabled():
        ways = " ".join(f"{p:.2f}" for p in choice.p)
        print(f"\n{target}: {ways}, elsewhere {choice.elsewhere:.2f}, scene {choice.scene:.2f}")


def test_detected_objects_change_the_scene_score(scorer):
    several = [put_to(scorer, view("chair", 3, seen)) for seen in ((), SEEN, SEEN[::-1])]
    assert len({choice.scene for choice in several}) == 3


def test_the_second_question_reuses_the_prompt_cache(scorer, monkeypatch):
    timings = []
    read = scorer._model._client._parse_log_probabilities

    def note(reply):
        timings.append(json.loads(reply.body)["timings"])
        return read(reply)

    monkeypatch.setattr(scorer._model._client, "_parse_log_probabilities", note)
    put_to(scorer, view("piano", 5, (DetectedObject("stove", 0.0, 4.0),)))
    _, second = timings
    assert second["cache_n"] > second["prompt_n"]


def test_an_image_for_a_text_model_is_an_error(url):
    blind = make_server_scorer(ChoiceOpenai(url=url, model="default", time_limit_s=PATIENCE_S))
    with pytest.raises(ChatError, match=r"answered HTTP [45]\d\d: .*image") as raised:
        put_to(blind, view("chair", 2, rgb=np.zeros((64, 80, 3), np.uint8)))
    assert "\n" not in str(raised.value)
