"""The interface of the translators, and their registry."""

from __future__ import annotations

import pytest

from edge.config import TranslatorGrammar, TranslatorLtl
from edge.errors import UserError
from edge.mission.ltl import FormulaError, ap, eventually, parse
from edge.mission.translate import AmbiguousError, TranslationError, make_translator, validated

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


def test_an_ambiguous_instruction_is_asked_about() -> None:
    grammar = make_translator(TranslatorGrammar())
    said = "go to the bed without the sofa, then to the tv"
    with pytest.raises(AmbiguousError, match=r"\(1\) Reach .* \(2\) Reach .*Never") as asked:
        grammar.translate(said)
    assert len(str(asked.value).splitlines()) == 1
    english = tuple(reading.english for reading in asked.value.readings)
    assert asked.value.implied == 1
    for number, reading in enumerate(asked.value.readings, 1):
        chosen = grammar.translate(said, reading=number)
        assert chosen.formula == reading.formula
        assert (chosen.reading, chosen.readings, chosen.implied) == (number, english, False)
    unasked = grammar.translate(said, ask=False)
    assert (unasked.reading, unasked.readings, unasked.implied) == (2, english, True)
    for number in (0, 3):
        with pytest.raises(TranslationError, match=f"there is no reading {number}"):
            grammar.translate(said, reading=number)


def test_what_is_plain_has_one_reading() -> None:
    grammar = make_translator(TranslatorGrammar())
    for translation in (grammar.translate("go to the bed"), grammar.translate("bed", reading=1)):
        assert (translation.reading, translation.readings, translation.implied) == (None, (), False)
    with pytest.raises(TranslationError, match="in 1 way"):
        grammar.translate("go to the bed", reading=2)


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
