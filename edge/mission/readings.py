"""What an instruction may mean where English leaves it open: its readings, told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge.mission.language.english import describe
from edge.mission.language.words import TranslationError, UnclearError
from edge.mission.logic.automaton import Automaton, CompileError, compile_formula, implies
from edge.mission.logic.diagnosis import diagnose
from edge.mission.logic.ltl import Formula, postorder
from edge.text import one_line

_MAX_STATES, _MAX_STEPS = 2_000, 3_000_000  # of each reading; larger ones are not compared
_SHOWN = 300  # characters of each reading


@dataclass(frozen=True, slots=True)
class Reading:
    """One thing that an instruction may mean, and the same in plain English."""

    formula: Formula
    english: str


class AmbiguousError(TranslationError):
    """An instruction that can be read in several ways, or in one that may not be meant.

    Attributes:
        readings: one or more, of different languages.
        implied: the index of the reading that implies all others, which is the safer one: whoever
            fulfils it fulfils them all. None where there is none, it is not known, or none of them
            may be taken unasked.
        doubts: what is doubted of single words, as "firdge: fridge?".
    """

    def __init__(
        self, readings: tuple[Reading, ...], implied: int | None, doubts: Sequence[str] = ()
    ) -> None:
        listed = " ".join(
            f"({i}) {one_line(reading.english, _SHOWN)}" for i, reading in enumerate(readings, 1)
        )
        several = f"it can be read in {len(readings)} ways, choose a reading"
        single = "it may be meant so; if it is, choose reading 1"
        what = "; ".join((*doubts, several if len(readings) > 1 else single))
        super().__init__(f"instruction: {what}: {listed}")
        self.readings = readings
        self.details = {
            "readings": [one_line(one.english, _SHOWN) for one in readings],
            "doubts": list(doubts),
        }
        self.implied = implied
        self.doubts = tuple(doubts)


def refuse_contradiction(formulas: Sequence[Formula]) -> None:
    """Refuse an instruction of which no reading can be fulfilled.

    Beside one that can, `distinct` leaves such readings out.

    Raises:
        UnclearError: nothing fulfils it.
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
        return  # the mission says so
    if conflict:
        told = one_line(" ".join(map(describe, parts)), _SHOWN)
        raise UnclearError(f"instruction: a contradiction, nothing does all of this: {told}")


def is_possible(formula: Formula) -> bool:
    """Return whether something fulfils a formula; True if it is too large to compile."""
    try:
        return compile_formula(formula, _MAX_STATES, _MAX_STEPS).steps_left[0] >= 0
    except CompileError:
        return True  # the mission says so


def same(a: Formula, b: Formula) -> bool:
    """Whether two formulas ask for the same; False where one is too large to compile."""
    return len(distinct((a, b))[0]) == 1


def distinct(formulas: Sequence[Formula]) -> tuple[tuple[Formula, ...], int | None]:
    """The formulas that differ in what they ask for, and the one that implies all of them.

    One that cannot be fulfilled, or asks for nothing, is left out beside others: nobody means it.

    Returns:
        The formulas in their order, and an index, see `AmbiguousError`; with a formula too large
            to compile, all of them and None.
    """
    formulas = tuple(dict.fromkeys(formulas))
    if len(formulas) == 1:
        return formulas, None
    try:
        compiled = [compile_formula(formula, _MAX_STATES, _MAX_STEPS) for formula in formulas]
    except CompileError:
        return formulas, None
    kept: list[Automaton] = []
    for automaton in [a for a in compiled if a.steps_left[0] > 0] or compiled:
        if not any(implies(automaton, other) and implies(other, automaton) for other in kept):
            kept.append(automaton)
    strongest = (i for i, a in enumerate(kept) if all(implies(a, other) for other in kept))
    return tuple(a.formula for a in kept), next(strongest, None) if len(kept) > 1 else None
