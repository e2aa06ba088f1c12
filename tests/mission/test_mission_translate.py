"""The interface of the translators, and their registry."""

from __future__ import annotations

import pytest

from edge.config import TranslatorGrammar, TranslatorLtl
from edge.errors import UserError
from edge.mission.ltl import FormulaError, ap, eventually, parse
from edge.mission.translate import TranslationError, make_translator, validated

BACKENDS = [
    (TranslatorGrammar(), "reach a tv, then a couch"),
    (TranslatorLtl(), "F (television & F sofa)"),
]


@pytest.mark.parametrize(("config", "instruction"), BACKENDS)
def test_translates(config: TranslatorGrammar | TranslatorLtl, instruction: str) -> None:
    translation = make_translator(config).translate(instruction)
    assert translation.formula == parse("F (television & F sofa)")
    assert translation.english == "Reach the television, then the sofa."
    assert translation.instruction == instruction
    assert translation.backend == config.kind
    assert 0 <= translation.seconds < 60


def test_errors_are_the_users() -> None:
    with pytest.raises(FormulaError, match="column"):
        make_translator(TranslatorLtl()).translate("F (bed")
    with pytest.raises(TranslationError, match=r"character 1: did not understand 'hum'"):
        make_translator(TranslatorGrammar()).translate("hum")
    assert issubclass(TranslationError, UserError)


def test_a_formula_without_a_text_is_refused() -> None:
    """Whatever a backend makes, its text must mean it."""
    assert validated(eventually(ap("trash can"))) == eventually(ap("trash can"))
    broken = parse("F a & F b")
    object.__setattr__(broken, "args", (broken.args[0],))  # & of one: its text is "F a"
    with pytest.raises(TranslationError, match="another formula"):
        validated(broken)
