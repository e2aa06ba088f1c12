"""Delexicalised tasks of the planning benchmark: formulas with letters in place of object names.

Many tasks then share a formula, and so one automaton.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import Formula, propositions, renamed

HM3D_OBJECTS = ("chair", "bed", "houseplant", "toilet", "television", "sofa")
"""HM3D's six object-goal categories, by canonical name."""


@dataclass(frozen=True, slots=True)
class DelexicalisedFormula:
    """A formula over the propositions a, b, … in order of first appearance.

    Attributes:
        others: number of objects in the world that the formula does not name.
    """

    formula: Formula
    others: int

    @property
    def automaton(self) -> Automaton:
        """Automaton of the formula, compiled once a process."""
        return compiled(self.formula)


def delexicalise(formula: Formula) -> DelexicalisedFormula:
    """Replace the objects of a task's formula by propositions, in the order of `world_of`."""
    objects = propositions(formula)
    letters = {name: chr(ord("a") + i) for i, name in enumerate(objects)}
    others = len(world_of(objects)) - len(objects)
    return DelexicalisedFormula(renamed(formula, letters.__getitem__), others)


def world_of(objects: tuple[str, ...]) -> tuple[str, ...]:
    """Return all objects of a task's world: the task's own, then the rest of HM3D's six."""
    return objects + tuple(o for o in HM3D_OBJECTS if o not in objects)


@cache
def compiled(formula: Formula) -> Automaton:
    """Return the automaton of a delexicalised formula.

    Raises:
        CompileError: it grows beyond the compiler's limits.
    """
    return compile_formula(formula)
