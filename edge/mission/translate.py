"""From an instruction to a formula: one translator, which a configuration gives its reader."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from edge.config import TranslatorGrammar, TranslatorLlm, TranslatorLtl
from edge.mission import ltl
from edge.mission.language import grammar
from edge.mission.language.english import describe
from edge.mission.language.words import TranslationError
from edge.mission.ltl import Formula
from edge.mission.readings import AmbiguousError, Reading, distinct
from edge.text import one_line

_UNDERSTOOD_CHARS = 1000  # English says in 300 characters what a formula says in 100

__all__ = [
    "AmbiguousError", "Reading", "Translation", "TranslationError", "Translator", "make_translator",
]  # fmt: skip


@dataclass(frozen=True)
class Translation:
    """An instruction and what was understood.

    Attributes:
        formula: its text parses back to the same formula.
        english: the formula in plain English, to be shown to whoever gave the instruction.
        backend: the translator's kind.
        seconds: how long it took.
        reading: which of the readings was taken, counted from 1; None: there is but one.
        readings: all of an ambiguous instruction's readings in English; none of another's.
        implied: the reading was taken unasked, since it implies all others.
    """

    instruction: str
    formula: Formula
    english: str
    backend: str
    seconds: float = 0.0
    reading: int | None = None
    readings: tuple[str, ...] = ()
    implied: bool = False

    @property
    def understood(self) -> str:
        """`english` as it is shown: one line, of what is longer than any instruction the start."""
        return one_line(self.english, _UNDERSTOOD_CHARS)


@dataclass(frozen=True)
class Translator:
    """Turns instructions into formulas.

    Attributes:
        read: the formulas that an instruction may ask for, one or more.
    """

    kind: str
    read: Callable[[str], Sequence[Formula]]

    def translate(
        self, instruction: str, reading: int | None = None, ask: bool = True
    ) -> Translation:
        """The instruction's formula.

        Args:
            reading: which one an ambiguous instruction is to be given, counted from 1 in the order
                in which `AmbiguousError` lists them; of an unambiguous one it can only be 1.
            ask: whether somebody can be asked. If not, the reading that implies all others is
                taken, where there is one.

        Raises:
            UserError: it cannot be translated; a TranslationError names the part.
            AmbiguousError: it can be read in several ways, and none was chosen.
        """
        began_s = time.monotonic()
        formulas, safer = distinct([validated(formula) for formula in self.read(instruction)])
        readings = tuple(Reading(formula, describe(formula)) for formula in formulas)
        if reading is not None and not 1 <= reading <= len(readings):
            ways = "way" if len(readings) == 1 else "ways"
            raise TranslationError(
                f"instruction: it can be read in {len(readings)} {ways}: there is no reading "
                f"{reading}"
            )
        if reading is None and len(readings) > 1 and (ask or safer is None):
            raise AmbiguousError(readings, safer)
        taken = readings[reading - 1 if reading is not None else safer or 0]
        seconds = time.monotonic() - began_s
        translation = Translation(instruction, taken.formula, taken.english, self.kind, seconds)
        if len(readings) == 1:
            return translation
        return replace(
            translation,
            reading=1 + readings.index(taken),
            readings=tuple(one.english for one in readings),
            implied=reading is None,
        )


def validated(formula: Formula) -> Formula:
    """The formula, once its text has been seen to parse back to it.

    Raises:
        TranslationError: it does not.
    """
    try:
        again = ltl.parse(ltl.to_text(formula))
    except ltl.FormulaError as error:
        raise TranslationError(f"the formula cannot be written as text: {error}") from error
    if again != formula:
        raise TranslationError(f"the formula's text means another formula: {one_line(formula)}")
    return formula


def make_translator(config: TranslatorLtl | TranslatorGrammar | TranslatorLlm) -> Translator:
    """The translator that a configuration names.

    Raises:
        ChatError: the language model's URL or API key cannot be used.
    """
    if config.kind == "grammar":
        return Translator("grammar", grammar.readings)
    if config.kind == "ltl":
        return Translator("ltl", lambda text: (ltl.parse(text),))
    from edge.mission.language.llm import Model  # needs the chat client; the others do not

    model = Model(config)
    return Translator("llm", lambda text: (model.read(text),))
