"""Translation of an instruction to a formula, by the back end that the configuration names."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from edge.config import Translator as TranslatorConfig
from edge.config import TranslatorLlm
from edge.errors import UnavailableError
from edge.mission.destinations import Destination
from edge.mission.language.grammar.bans import bans_in, does_imply
from edge.mission.language.grammar.english import describe
from edge.mission.language.grammar.instruction import readings
from edge.mission.language.grammar.unsupported import refuse_unsupported
from edge.mission.language.words.tokens import TokenReader, TranslationError, UnclearError
from edge.mission.logic import ltl
from edge.mission.logic.ltl import Formula
from edge.mission.readings import (
    AmbiguousInstructionError,
    Reading,
    distinct,
    is_possible,
    refuse_contradiction,
    same_language,
)
from edge.mission.repetition import Repetition
from edge.text import one_line

if TYPE_CHECKING:
    from edge.mission.language.networks.model import NeuralTranslator

log = logging.getLogger(__name__)

_UNDERSTOOD_CHARS = 1000  # English needs about three times as many characters as a formula

__all__ = [
    "AmbiguousInstructionError", "ParsedInstruction", "Reading", "Translation", "TranslationError",
    "Translator", "make_translator",
]  # fmt: skip


@dataclass(frozen=True)
class Translation:
    """An instruction and its translation.

    Attributes:
        instruction: the given text.
        formula: its text parses back to the same formula.
        english: the formula in plain English, for the person who gave the instruction.
        backend: kind of the translator that read it.
        seconds: duration of the translation.
        reading: number of the chosen reading, from 1; None if there is only one.
        readings: all readings of an ambiguous instruction in English, else empty.
        implied: True if the reading was chosen without a question, because it implies all others.
        destinations: propositions of the formula that are no objects to search for.
        repeat: the end of a mission that repeats in rounds, each as the formula says; else None.
        warning: fault of a translator that was replaced by another; "" if there was none.
    """

    instruction: str
    formula: Formula
    english: str
    backend: str
    seconds: float = 0.0
    reading: int | None = None
    readings: tuple[str, ...] = ()
    implied: bool = False
    destinations: Mapping[str, Destination] = field(default_factory=dict)
    repeat: Repetition | None = None
    warning: str = ""

    @property
    def understood(self) -> str:
        """`english` in one line, cut at `_UNDERSTOOD_CHARS` characters."""
        return one_line(self.english, _UNDERSTOOD_CHARS)


@dataclass(frozen=True)
class ParsedInstruction:
    """The result of a translator back end.

    Attributes:
        formulas: one or more possible formulas, the most likely first.
        backend: kind of the translator that read the instruction.
        confident: True if one formula may be carried out without a question. Of several, the one
            that implies the others may be used if no person can be asked.
        doubts: questions about single words, shown with the question.
        warning: see `Translation`.
    """

    formulas: Sequence[Formula]
    backend: str
    confident: bool = True
    doubts: tuple[str, ...] = ()
    warning: str = ""


Backend = Callable[[str], ParsedInstruction]
"""Function that reads an instruction; raises TranslationError if it does not understand it."""


@dataclass(frozen=True)
class Translator:
    """Translator of instructions to formulas.

    Attributes:
        kind: kind of the configuration's section `mission.translator`.
        read: the back end that reads instructions.

    Example:
        >>> from edge.config import TranslatorGrammar
        >>> read = make_translator(TranslatorGrammar()).translate("Go to the bed or the sofa.")
        >>> str(read.formula), read.english
        ('F (bed | sofa)', 'Reach either the bed or the sofa.')
    """

    kind: str
    read: Backend

    def translate(
        self, instruction: str, reading: int | None = None, ask: bool = True
    ) -> Translation:
        """Return the translation of an instruction.

        Args:
            instruction: English text, or a formula for the kind `ltl`.
            reading: number of the chosen reading, from 1, in the order of
                `AmbiguousInstructionError`. For an unambiguous instruction only 1 is valid.
            ask: True if a person can choose. If False, the reading that implies all others is
                taken, if there is one.

        Raises:
            UserError: the instruction cannot be translated; a TranslationError names the part.
            AmbiguousInstructionError: there are several readings, or one that is not sure, and
                none was chosen.
        """
        began_s = time.monotonic()
        read = self.read(instruction)
        formulas, strongest = distinct([check_text(formula) for formula in read.formulas])
        readings = tuple(Reading(formula, describe(formula)) for formula in formulas)
        if reading is not None and not 1 <= reading <= len(readings):
            ways = "way" if len(readings) == 1 else "ways"
            raise TranslationError(
                f"reading: there is no reading {reading}: the instruction can be read in "
                f"{len(readings)} {ways}"
            )
        unclear = len(readings) > 1 and (ask or strongest is None)
        if reading is None and (unclear or not read.confident):
            raise AmbiguousInstructionError(
                readings, strongest if read.confident else None, read.doubts
            )
        taken = readings[reading - 1 if reading is not None else strongest or 0]
        seconds = time.monotonic() - began_s
        translation = Translation(
            instruction, taken.formula, taken.english, read.backend, seconds, warning=read.warning
        )
        if len(readings) == 1:
            return translation
        return replace(
            translation,
            reading=1 + readings.index(taken),
            readings=tuple(each.english for each in readings),
            implied=reading is None,
        )


def check_text(formula: Formula) -> Formula:
    """Return the formula after checking that its text parses back to it.

    Raises:
        TranslationError: it does not.
    """
    try:
        again = ltl.parse(ltl.to_text(formula))
    except ltl.FormulaError as error:
        raise TranslationError(f"the formula cannot be written as text: {error}") from error
    if again != formula:
        raise TranslationError(
            f"a bug in edge: written as text, the formula {one_line(formula)} changes its meaning; "
            "report it"
        )
    return formula


def make_translator(config: TranslatorConfig) -> Translator:
    """Return the translator that a configuration names.

    Raises:
        ChatError: the URL or the API key of the language model cannot be used.
        ModelError: the card or the file of the small model is missing or damaged. `auto` raises it
            later, at the first instruction that the grammar refuses.
    """
    readers: dict[str, Callable[[], Backend]] = {
        "grammar": lambda: _read_by_grammar,
        "ltl": lambda: lambda text: ParsedInstruction((ltl.parse(text),), "ltl"),
        "llm": lambda: _llm_backend(config),
        "model": lambda: small_model_backend(_load_small_model(config.card)),
        # The model is loaded at the first refusal by the grammar: most instructions need none.
        "auto": lambda: combined_backend(
            lambda text: small_model_backend(_load_small_model(config.card))(text),
            config.llm and _llm_backend(config.llm, must_live=True),
        ),
    }
    return Translator(config.kind, readers[config.kind]())


def _read_by_grammar(instruction: str) -> ParsedInstruction:
    formulas = readings(instruction)
    refuse_contradiction(formulas)
    return ParsedInstruction(formulas, "grammar")


def _llm_backend(config: TranslatorLlm, must_live: bool = False) -> Backend:
    from edge.mission.language.networks.llm import (
        LlmTranslator,  # needs the chat client; the others do not
    )

    model = LlmTranslator(config, must_live)
    return lambda text: with_bans(text, ParsedInstruction((model.read(text),), "llm"))


@lru_cache(maxsize=1)
def _load_small_model(card: str) -> NeuralTranslator:
    from edge.mission.language.networks.model import (
        NeuralTranslator,  # needs onnxruntime; the grammar does not
    )
    from edge.mission.language.networks.network import TranslationNetwork

    return NeuralTranslator(TranslationNetwork(card))


def small_model_backend(model: NeuralTranslator) -> Backend:
    """Return a back end that uses only the small model."""

    def read(instruction: str) -> ParsedInstruction:
        refuse_unsupported(TokenReader(instruction))
        found = model.read(instruction)
        return with_bans(
            instruction, ParsedInstruction(found.formulas, "model", found.confident, found.doubts)
        )

    return read


def with_bans(instruction: str, read: ParsedInstruction) -> ParsedInstruction:
    """Return a model's result, checked against the bans that the grammar rules find.

    If the result misses a ban, it becomes a question with two groups of formulas: with the bans,
    and as the model wrote them.

    Raises:
        TranslationError: no formula can be fulfilled together with the bans.
    """
    bans = [
        ban
        for ban in bans_in(instruction)
        if not all(does_imply(formula, ban) for formula in read.formulas)
    ]
    if not bans:
        return read
    strict = [ltl.conj(formula, *bans) for formula in read.formulas]
    strict = [formula for formula in strict if is_possible(formula)]
    if not strict:
        found = " ".join(describe(ban) for ban in bans)
        raise TranslationError(
            f"instruction: understood only this: {one_line(found, 300)}; say the rest in "
            "other words"
        )
    return replace(read, formulas=(*strict, *read.formulas), confident=False)


def combined_backend(small: Backend, large: Backend | None) -> Backend:
    """Return a back end: grammar, then small model, then language model (see `TranslatorAuto`).

    If the grammar is certain that a text is no order, or is unclear, no model is asked.
    """

    def read(instruction: str) -> ParsedInstruction:
        try:
            return _read_by_grammar(instruction)
        except UnclearError:
            raise
        except TranslationError as refusal:
            return _ask_models(instruction, refusal, small, large)

    return read


def _ask_models(
    instruction: str, refusal: TranslationError, small: Backend, large: Backend | None
) -> ParsedInstruction:
    """Ask the models about an instruction that the grammar refused.

    The language model's formula is trusted if the small model offers the same one, or none. If its
    server fails, the others decide without it.

    Raises:
        TranslationError: the models refuse it too. The grammar's error is raised, because it gives
            the best advice.
    """
    try:
        offered = small(instruction)
    except TranslationError:
        if large is None:
            raise refusal from None
        try:
            return large(instruction)
        except UnavailableError as error:
            warning = f"{refusal}; {_without_server(error)}"
            raise TranslationError(warning, refusal.part, refusal.position) from None
    if offered.confident or large is None:
        return offered
    try:
        answer = large(instruction)
    except TranslationError:
        return offered
    except UnavailableError as error:
        return replace(offered, warning=_without_server(error))
    if any(same_language(answer.formulas[0], formula) for formula in offered.formulas):
        return answer
    return ParsedInstruction((*answer.formulas, *offered.formulas), "llm", False, offered.doubts)


def _without_server(error: UnavailableError) -> str:
    """Return a warning that the language model was not asked, and log it."""
    warning = f"translated without the language model: {one_line(error)}"
    log.warning("mission: %s", warning)
    return warning
