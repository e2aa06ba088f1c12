"""From an instruction to a formula: one interface, a backend per kind of configuration."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

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
        backend: the kind of translator.
        seconds: how long it took.
        attempts: requests made; 1 for the offline backends.
    """

    instruction: str
    formula: ltl.Formula
    english: str
    backend: str
    seconds: float = 0.0
    attempts: int = 1

    @property
    def understood(self) -> str:
        """`english` as it is shown: one line, of what is longer than any instruction the start."""
        return one_line(self.english, _UNDERSTOOD_CHARS)


class Translator(Protocol):
    """Anything that turns an instruction into a formula."""

    def translate(self, instruction: str) -> Translation:
        """The instruction's formula.

        Raises:
            UserError: it cannot be translated; a TranslationError names the part.
        """
        ...


@dataclass(frozen=True)
class OfflineTranslator:
    """A translator that is a function of the instruction alone."""

    kind: str
    parse: Callable[[str], ltl.Formula]

    def translate(self, instruction: str) -> Translation:
        """See `Translator.translate`."""
        began = time.perf_counter()
        formula = validated(self.parse(instruction))
        return Translation(
            instruction, formula, describe(formula), self.kind, time.perf_counter() - began
        )


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


def _make_llm(config: TranslatorLlm) -> Translator:
    from edge.mission.language.llm import make  # needs the chat client; the offline backends do not

    return make(config)


_BACKENDS: dict[str, Callable[..., Translator]] = {
    "ltl": lambda _: OfflineTranslator("ltl", ltl.parse),
    "grammar": lambda _: OfflineTranslator("grammar", grammar.parse_english),
    "llm": _make_llm,
}


def make_translator(config: TranslatorLtl | TranslatorGrammar | TranslatorLlm) -> Translator:
    """The backend that a configuration names."""
    return _BACKENDS[config.kind](config)
