"""From an instruction to a formula: one translator, which a configuration gives its reader."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from edge.config import TranslatorGrammar, TranslatorLlm, TranslatorLtl
from edge.mission import ltl
from edge.mission.language import grammar
from edge.mission.language.english import describe
from edge.mission.language.words import TranslationError
from edge.text import one_line

_UNDERSTOOD_CHARS = 1000  # English says in 300 characters what a formula says in 100

__all__ = ["Translation", "TranslationError", "Translator", "make_translator"]


@dataclass(frozen=True)
class Translation:
    """An instruction and what was understood.

    Attributes:
        formula: its text parses back to the same formula.
        english: the formula in plain English, to be shown to whoever gave the instruction.
        backend: the translator's kind.
        seconds: how long it took.
    """

    instruction: str
    formula: ltl.Formula
    english: str
    backend: str
    seconds: float = 0.0

    @property
    def understood(self) -> str:
        """`english` as it is shown: one line, of what is longer than any instruction the start."""
        return one_line(self.english, _UNDERSTOOD_CHARS)


@dataclass(frozen=True)
class Translator:
    """Turns instructions into formulas.

    Attributes:
        read: the formula that an instruction asks for.
    """

    kind: str
    read: Callable[[str], ltl.Formula]

    def translate(self, instruction: str) -> Translation:
        """The instruction's formula.

        Raises:
            UserError: it cannot be translated; a TranslationError names the part.
        """
        began_s = time.monotonic()
        formula = self.read(instruction)
        english, seconds = describe(validated(formula)), time.monotonic() - began_s
        return Translation(instruction, formula, english, self.kind, seconds)


def validated(formula: ltl.Formula) -> ltl.Formula:
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


_READERS = {"ltl": ltl.parse, "grammar": grammar.parse_english}


def make_translator(config: TranslatorLtl | TranslatorGrammar | TranslatorLlm) -> Translator:
    """The translator that a configuration names.

    Raises:
        ChatError: the language model's URL or API key cannot be used.
    """
    if config.kind == "llm":
        from edge.mission.language.llm import Model  # needs the chat client; the others do not

        return Translator("llm", Model(config).read)
    return Translator(config.kind, _READERS[config.kind])
