"""From an instruction to a formula: one translator, which a configuration gives its reader."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from edge.config import Translator as TranslatorConfig
from edge.config import TranslatorLlm
from edge.geometry import SE2
from edge.mission.language import grammar
from edge.mission.language.bans import bans_in, does_imply
from edge.mission.language.beyond import refuse_beyond
from edge.mission.language.english import describe
from edge.mission.language.words import Reader, TranslationError, UnclearError
from edge.mission.logic import ltl
from edge.mission.logic.ltl import Formula
from edge.mission.readings import (
    AmbiguousError,
    Reading,
    distinct,
    is_possible,
    refuse_contradiction,
    same,
)
from edge.text import one_line

if TYPE_CHECKING:
    from edge.mission.language.model import SmallModel

_UNDERSTOOD_CHARS = 1000  # English says in 300 characters what a formula says in 100

__all__ = [
    "AmbiguousError", "Read", "Reading", "Translation", "TranslationError", "Translator",
    "make_translator",
]  # fmt: skip


@dataclass(frozen=True)
class Translation:
    """An instruction and what was understood.

    Attributes:
        formula: its text parses back to the same formula.
        english: the formula in plain English, to be shown to whoever gave the instruction.
        backend: the kind of translator that read it.
        seconds: how long it took.
        reading: which of the readings was taken, counted from 1; None: there is but one.
        readings: all of an ambiguous instruction's readings in English; none of another's.
        implied: the reading was taken unasked, since it implies all others.
        places: propositions of the formula that are places, not things, with their poses; None for
            a pose that is known only when the mission begins.
    """

    instruction: str
    formula: Formula
    english: str
    backend: str
    seconds: float = 0.0
    reading: int | None = None
    readings: tuple[str, ...] = ()
    implied: bool = False
    places: Mapping[str, SE2 | None] = field(default_factory=dict)

    @property
    def understood(self) -> str:
        """`english` as it is shown: one line, of what is longer than any instruction the start."""
        return one_line(self.english, _UNDERSTOOD_CHARS)


@dataclass(frozen=True)
class Read:
    """What a translator made of an instruction.

    Attributes:
        formulas: that it may ask for, one or more, the likeliest first.
        by: the kind of translator that read it.
        sure: one formula may be carried out unasked, and of several the one that implies the
            others where nobody can be asked.
        doubts: of words, to be told with a question.
    """

    formulas: Sequence[Formula]
    by: str
    sure: bool = True
    doubts: tuple[str, ...] = ()


Backend = Callable[[str], Read]
"""Reads an instruction; raises TranslationError for what it does not understand."""


@dataclass(frozen=True)
class Translator:
    """Turns instructions into formulas."""

    kind: str
    read: Backend

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
            AmbiguousError: it can be read in several ways, or in one that is not sure, and none
                was chosen.
        """
        began_s = time.monotonic()
        read = self.read(instruction)
        formulas, safer = distinct([validated(formula) for formula in read.formulas])
        readings = tuple(Reading(formula, describe(formula)) for formula in formulas)
        if reading is not None and not 1 <= reading <= len(readings):
            ways = "way" if len(readings) == 1 else "ways"
            raise TranslationError(
                f"instruction: it can be read in {len(readings)} {ways}: there is no reading "
                f"{reading}"
            )
        unclear = len(readings) > 1 and (ask or safer is None)
        if reading is None and (unclear or not read.sure):
            raise AmbiguousError(readings, safer if read.sure else None, read.doubts)
        taken = readings[reading - 1 if reading is not None else safer or 0]
        seconds = time.monotonic() - began_s
        translation = Translation(instruction, taken.formula, taken.english, read.by, seconds)
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


def make_translator(config: TranslatorConfig) -> Translator:
    """The translator that a configuration names.

    Raises:
        ChatError: the language model's URL or API key cannot be used.
        ModelError: the small model's card or file is not there or not sound; `auto` says so of the
            first instruction that the grammar refuses.
    """
    readers: dict[str, Callable[[], Backend]] = {
        "grammar": lambda: _by_grammar,
        "ltl": lambda: lambda text: Read((ltl.parse(text),), "ltl"),
        "llm": lambda: _by_llm(config),
        "model": lambda: by_model(_small_model(config.card)),
        # Opened when the grammar has refused something: most instructions need no network.
        "auto": lambda: by_all(
            lambda text: by_model(_small_model(config.card))(text),
            config.llm and _by_llm(config.llm),
        ),
    }
    return Translator(config.kind, readers[config.kind]())


def _by_grammar(instruction: str) -> Read:
    formulas = grammar.readings(instruction)
    refuse_contradiction(formulas)
    return Read(formulas, "grammar")


def _by_llm(config: TranslatorLlm) -> Backend:
    from edge.mission.language.llm import Model  # needs the chat client; the others do not

    model = Model(config)
    return lambda text: heeding(text, Read((model.read(text),), "llm"))


@lru_cache(maxsize=1)
def _small_model(card: str) -> SmallModel:
    from edge.mission.language.model import SmallModel  # needs onnxruntime; the grammar does not
    from edge.mission.language.network import Network

    return SmallModel(Network(card))


def by_model(model: SmallModel) -> Backend:
    """The small model alone."""

    def read(instruction: str) -> Read:
        refuse_beyond(Reader(instruction))
        found = model.read(instruction)
        return heeding(instruction, Read(found.formulas, "model", found.sure, found.doubts))

    return read


def heeding(instruction: str, read: Read) -> Read:
    """Return what a model read, if it heeds the bans that the rules read in the instruction.

    If it does not, it is asked about: with these bans, and as it is.

    Raises:
        TranslationError: nothing fulfils it together with the bans.
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
        told = " ".join(describe(ban) for ban in bans)
        raise TranslationError(f"instruction: understood only this: {one_line(told, 300)}")
    return replace(read, formulas=(*strict, *read.formulas), sure=False)


def by_all(small: Backend, large: Backend | None) -> Backend:
    """The grammar first, then the small model, then a language model: see `TranslatorAuto`.

    What the grammar knows to be no order, or to be unclear, none of the others is asked.
    """

    def read(instruction: str) -> Read:
        try:
            return _by_grammar(instruction)
        except UnclearError:
            raise
        except TranslationError as refusal:
            return _unread(instruction, refusal, small, large)

    return read


def _unread(
    instruction: str, refusal: TranslationError, small: Backend, large: Backend | None
) -> Read:
    """What the others make of what the grammar refused.

    A language model's formula is taken where the small one offers it too, or has none to offer.

    Raises:
        TranslationError: they refuse it as well; the grammar tells best what to change.
    """
    try:
        offered = small(instruction)
    except TranslationError:
        if large is None:
            raise refusal from None
        return large(instruction)
    if offered.sure or large is None:
        return offered
    try:
        told = large(instruction)
    except TranslationError:
        return offered
    if any(same(told.formulas[0], formula) for formula in offered.formulas):
        return told
    return Read((*told.formulas, *offered.formulas), "llm", False, offered.doubts)
