"""What others, who had not seen the grammar, would say for a formula: never understood wrongly."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.config.mission import TranslatorGrammar
from edge.eval.translate import own_cases, score
from edge.mission.translate import make_translator

SAID = Path(__file__).with_name("said.tsv")


@pytest.fixture(scope="module")
def scores():
    translator = make_translator(TranslatorGrammar())
    return [score(case, translator) for case in own_cases(SAID)[0]]


def test_nothing_is_taken_for_another_thing(scores) -> None:
    wrong = [f"{s.case.sentence}: {s.got}" for s in scores if s.outcome == "wrong"]
    assert not wrong, "\n".join(wrong)


def test_most_is_understood(scores) -> None:
    right = sum(s.outcome in ("right", "right if weak") for s in scores)
    assert right >= 0.77 * len(scores)
