"""The interface of the translators, and their registry."""

from __future__ import annotations

import pytest

from edge.config import TranslatorAuto, TranslatorGrammar, TranslatorLtl
from edge.errors import UnavailableError
from edge.mission.logic.ltl import ap, eventually, parse
from edge.mission.translate import (
    AmbiguousInstructionError,
    Backend,
    ParsedInstruction,
    TranslationError,
    Translator,
    check_text,
    combined_backend,
    make_translator,
    with_bans,
)
from edge.perception.runtime.model_file import ModelError

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
    with pytest.raises(
        AmbiguousInstructionError, match=r"\(1\) Reach .* \(2\) Reach .*Never"
    ) as asked:
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


def test_a_formula_without_a_text_is_refused() -> None:
    """Whatever a backend makes, its text must mean it."""
    assert check_text(eventually(ap("trash can"))) == eventually(ap("trash can"))
    broken = parse("F a & F b")
    object.__setattr__(broken, "args", (broken.args[0],))  # & of one: its text is "F a"
    with pytest.raises(TranslationError, match="changes its meaning"):
        check_text(broken)


def _reader(*texts: str, sure: bool = True, doubts: tuple[str, ...] = ()) -> Backend:
    """Return a reader with these formulas for its inputs; it refuses without any."""

    def read(said: str) -> ParsedInstruction:
        if not texts:
            raise TranslationError(f"not the grammar's reason: {said}")
        return ParsedInstruction([parse(text) for text in texts], "stub", sure, doubts)

    return read


def _dead(said: str) -> ParsedInstruction:
    raise UnavailableError("http://base: nothing listens there")


# Said, what the small model and the large one make of it, the formulas then, who spoke, whether
# it is sure. The grammar reads the first instructions, and refuses the last.
PLAIN, OPEN, STRANGE = (
    "go to the bed",
    "go to the bed without the sofa, then to the tv",
    "skedaddle bed",
)
NOTHING = _reader()
TOGETHER = [
    (PLAIN, NOTHING, None, ["F bed"], "grammar", True),
    (PLAIN, _reader("F sofa"), None, ["F bed"], "grammar", True),
    (OPEN, _reader("F sofa"), None, 2, "grammar", True),
    (STRANGE, NOTHING, None, "did not understand 'skedaddle bed'", "", True),
    (STRANGE, _reader("F bed"), NOTHING, ["F bed"], "stub", True),
    (STRANGE, _reader("F bed", sure=False), None, ["F bed"], "stub", False),
    (STRANGE, _reader("F bed", sure=False), NOTHING, ["F bed"], "stub", False),
    (STRANGE, _reader("F bed", "F sofa", sure=False), _reader("F sofa"), ["F sofa"], "stub", True),
    (STRANGE, _reader("F bed", sure=False), _reader("F tv"), ["F tv", "F bed"], "llm", False),
    (STRANGE, NOTHING, _reader("F bed"), ["F bed"], "stub", True),
    (STRANGE, NOTHING, NOTHING, "not the grammar's reason", "", True),
    # The server of the large one is dead.
    (STRANGE, _reader("F bed", sure=False), _dead, ["F bed"], "stub", False),
    (
        STRANGE,
        NOTHING,
        _dead,
        "'skedaddle bed'.* without the language model: http://base: nothing",
        "",
        True,
    ),
    # The translator does not guess about a text without an order or with an unknown scope.
    (
        "have you been to the bed?",
        _reader("F bed"),
        _reader("F bed"),
        "not an instruction",
        "",
        True,
    ),
    ("don't just go to the bed", _reader("G !bed"), None, "say directly what not to do", "", True),
    ("go to the bed, never enter the bed", _reader("F bed"), None, "a contradiction", "", True),
]


@pytest.mark.parametrize(("said", "small", "large", "wanted", "by", "sure"), TOGETHER)
def test_auto_takes_the_reading_that_translators_agree_on(
    said: str, small: Backend, large: Backend | None, wanted: object, by: str, sure: bool
) -> None:
    read = combined_backend(small, large)
    if isinstance(wanted, str):
        with pytest.raises(TranslationError, match=wanted):
            read(said)
        return
    found = read(said)
    texts = [str(formula) for formula in found.formulas]
    assert len(texts) == wanted if isinstance(wanted, int) else texts == wanted
    assert (found.backend, found.confident) == (by, sure)


def test_a_mission_reports_that_the_language_model_did_not_answer() -> None:
    read = combined_backend(_reader("F bed", sure=False), _dead)
    found = Translator("auto", read).translate(STRANGE, reading=1)
    warning = "translated without the language model: http://base: nothing listens there"
    assert (str(found.formula), found.warning) == ("F bed", warning)


# Instruction, formula of a model, and the question to the user; a text is a refusal.
BANNED = [
    ("go to both sofas, but do not go to the table", "F sofa & G !table", None),
    ("go to both sofas, but do not go to the table", "F sofa | G !table",
     ["(F sofa | G !table) & G !table", "F sofa | G !table"]),
    ("skedaddle to the sofa without touching the bed or the tv", "F sofa & !bed W sofa",
     ["F sofa & !bed W sofa & G !bed", "F sofa & !bed W sofa"]),
    ("do not go to the tv before the bed, then skedaddle", "F television",
     ["F television & !television W bed", "F television"]),
    ("go to the sofa and never go to the tv", "!television W sofa",
     ["!television W sofa & G !television", "!television W sofa"]),
    ("skedaddle to the sofa, but avoid the sofa", "F sofa", "understood only this: Never reach"),
]  # fmt: skip


@pytest.mark.parametrize(("said", "formula", "asked"), BANNED)
def test_bans_of_the_rules_apply_to_a_models_formula(
    said: str, formula: str, asked: list[str] | str | None
) -> None:
    read = ParsedInstruction([parse(formula)], "llm")
    if isinstance(asked, str):
        with pytest.raises(TranslationError, match=asked):
            with_bans(said, read)
        return
    found = with_bans(said, read)
    assert found.confident is (asked is None)
    assert [str(one) for one in found.formulas] == (asked or [formula])


def test_auto_loads_no_network_if_the_grammar_suffices() -> None:
    auto = make_translator(TranslatorAuto(card="none"))
    assert auto.translate("go to the bed").backend == "grammar"
    with pytest.raises(ModelError, match="'none': no such card"):
        auto.translate("skedaddle bed")
