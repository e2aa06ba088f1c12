"""Readings of an ambiguous instruction: comparison as formal languages, and the question."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge.mission.language.grammar.english import describe
from edge.mission.language.words.tokens import TranslationError, UnclearError
from edge.mission.logic.automaton import Automaton, CompileError, compile_formula, implies
from edge.mission.logic.diagnosis import diagnose
from edge.mission.logic.ltl import Formula, postorder
from edge.text import one_line

# Limits of the compilation of each reading; larger ones are not compared.
_MAX_STATES, _MAX_STEPS = 2_000, 3_000_000
_SHOWN = 300  # characters of each reading


@dataclass(frozen=True, slots=True)
class Reading:
    """One possible meaning of an instruction."""

    formula: Formula
    english: str


class AmbiguousInstructionError(TranslationError):
    """An instruction with several readings, or with one that may not be meant.

    Attributes:
        readings: one or more, each a different language.
        implied: index of the reading that implies all others. It is the safer choice, because
            fulfilling it fulfils all others. None if there is no such reading, if it is unknown, or
            if a person must choose.
        doubts: questions about single words, such as "firdge: fridge?".
    """

    def __init__(
        self, readings: tuple[Reading, ...], implied: int | None, doubts: Sequence[str] = ()
    ) -> None:
        listed = " ".join(
            f"({i}) {one_line(reading.english, _SHOWN)}" for i, reading in enumerate(readings, 1)
        )
        several = f"it can be read in {len(readings)} ways, choose a reading"
        single = "not sure that this is the meaning; if so, choose reading 1"
        what = "; ".join((*doubts, several if len(readings) > 1 else single))
        super().__init__(f"instruction: {what}: {listed}")
        self.readings = readings
        self.details = {
            "readings": [one_line(reading.english, _SHOWN) for reading in readings],
            "doubts": list(doubts),
        }
        self.implied = implied
        self.doubts = tuple(doubts)


def refuse_contradiction(formulas: Sequence[Formula]) -> None:
    """Refuse an instruction if no reading of it can be fulfilled.

    `distinct` removes impossible readings if there is a possible one.

    Raises:
        UnclearError: no reading can be fulfilled.
    """
    if not any(f.op in ("!", "G", "W") for f in postorder(formulas[0])):
        return
    if any(is_possible(formula) for formula in formulas[1:]):
        return
    try:
        automaton = compile_formula(formulas[0], _MAX_STATES, _MAX_STEPS)
        conflict = automaton.steps_left[0] < 0
        parts = diagnose(automaton, _MAX_STATES, _MAX_STEPS).contradiction if conflict else ()
    except CompileError:
        return  # compiling the mission reports it
    if conflict:
        listed = one_line(" ".join(map(describe, parts)), _SHOWN)
        raise UnclearError(
            f"instruction: a contradiction, these parts exclude each other: {listed}"
        )


def is_possible(formula: Formula) -> bool:
    """Return True if a formula can be fulfilled, or is too large to compile."""
    try:
        return compile_formula(formula, _MAX_STATES, _MAX_STEPS).steps_left[0] >= 0
    except CompileError:
        return True  # compiling the mission reports it


def same_language(a: Formula, b: Formula) -> bool:
    """Return True if two formulas describe the same language; False if one is too large."""
    return len(distinct((a, b))[0]) == 1


def distinct(formulas: Sequence[Formula]) -> tuple[tuple[Formula, ...], int | None]:
    """Return the formulas with different meanings, and the index of the strongest one.

    The strongest formula implies all others. Formulas that cannot be fulfilled or that ask for
    nothing are left out if there are others.

    Returns:
        The formulas in their order, and an index or None (see `AmbiguousInstructionError`). If a
        formula is too large to compile: all formulas, and None.
    """
    formulas = tuple(dict.fromkeys(formulas))
    if len(formulas) == 1:
        return formulas, None
    try:
        compiled = [compile_formula(formula, _MAX_STATES, _MAX_STEPS) for formula in formulas]
    except CompileError:
        return formulas, None
    kept: list[Automaton] = []  # one for each language
    # Those that can be fulfilled and ask for something, or all if there are none.
    for automaton in [a for a in compiled if a.steps_left[0] > 0] or compiled:
        if not any(implies(automaton, other) and implies(other, automaton) for other in kept):
            kept.append(automaton)
    strongest = (i for i, a in enumerate(kept) if all(implies(a, other) for other in kept))
    return tuple(a.formula for a in kept), next(strongest, None) if len(kept) > 1 else None
