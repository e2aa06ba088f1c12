"""Tasks without their objects' names: many tasks share one formula, and so one automaton."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from edge import names
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import Formula, propositions, renamed

HM3D_OBJECTS = ("chair", "bed", "houseplant", "toilet", "television", "sofa")
"""HM3D's six object-goal categories, by their canonical names."""

MAX_OBJECTS = 12


@dataclass(frozen=True, slots=True)
class LiftedFormula:
    """A formula over the letters a, b, … in order of first appearance.

    Attributes:
        others: objects in the world that the formula does not name.
    """

    formula: Formula
    others: int

    @property
    def automaton(self) -> Automaton:
        """Compiled once a process."""
        return compiled(self.formula)


def lift(formula: Formula) -> LiftedFormula:
    """A task's formula with its objects left out; `world_of` gives them in the same order."""
    objects = propositions(formula)
    letters = {name: chr(ord("a") + i) for i, name in enumerate(objects)}
    others = len(world_of(objects)) - len(objects)
    return LiftedFormula(renamed(formula, letters.__getitem__), others)


def world_of(objects: tuple[str, ...]) -> tuple[str, ...]:
    """All objects of a task's world: the task's own, then the rest of HM3D's six."""
    return objects + tuple(o for o in HM3D_OBJECTS if o not in objects)


def with_canonical_names(formula: Formula) -> Formula:
    """`tv` becomes `television`, as in worlds and detectors (`edge.names`)."""
    return renamed(formula, names.canonical)


@cache
def compiled(formula: Formula) -> Automaton:
    """The automaton of a lifted formula.

    Raises:
        CompileError: it grows beyond the compiler's limits.
    """
    return compile_formula(formula)
