"""Checks of a formula before a mission starts: contradictions, and parts without effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.mission.logic.automaton import Automaton
from edge.mission.logic.compiler import minimal_automaton
from edge.mission.logic.limits import MAX_STATES, MAX_STEPS, CompileBudget
from edge.mission.logic.ltl import Formula, conj, propositions


@dataclass(frozen=True)
class Diagnosis:
    """The result of `diagnose`.

    Attributes:
        contradiction: a minimal set of conjuncts that cannot be fulfilled together: without any one
            of them, they could be. Empty if the formula can be fulfilled.
        tautology: True if every trace fulfils the formula.
        unused: propositions that make no difference to the formula.
    """

    contradiction: tuple[Formula, ...]
    tautology: bool
    unused: tuple[str, ...]


def diagnose(
    automaton: Automaton, max_states: int = MAX_STATES, max_steps: int = MAX_STEPS
) -> Diagnosis:
    """Return why a formula is useless as a mission, if it is.

    Raises:
        CompileError: a limit was exceeded.
    """
    nothing = automaton.delta[:, -1]  # next states after a step that reaches no object
    unused = tuple(
        name
        for k, name in enumerate(automaton.propositions)
        if np.array_equal(automaton.delta[:, k], nothing)
    )
    conflict: tuple[Formula, ...] = ()
    if not automaton.accepting.any():
        conflict = _find_conflict(automaton.formula, CompileBudget(max_states, max_steps))
    return Diagnosis(conflict, bool(automaton.accepting.all()), unused)


def conjuncts(formula: Formula) -> tuple[Formula, ...]:
    """Return the conjuncts of a formula in their order, nested conjunctions flattened."""
    found: list[Formula] = []
    todo = [formula]
    while todo:
        f = todo.pop()
        if f.op == "&":
            todo.extend(reversed(f.args))
        else:
            found.append(f)
    return tuple(dict.fromkeys(found))


def _find_conflict(formula: Formula, budget: CompileBudget) -> tuple[Formula, ...]:
    """Return a minimal contradictory subset of the conjuncts.

    Later conjuncts are dropped first, so the first parts of the instruction stay.
    """
    kept = list(conjuncts(formula))
    for part in reversed(kept.copy()):
        fewer = [f for f in kept if f is not part]
        if fewer and not _is_possible(conj(*fewer), budget):
            kept = fewer
    return tuple(kept)


def _is_possible(formula: Formula, budget: CompileBudget) -> bool:
    _, accepting = minimal_automaton(formula, propositions(formula), budget)
    return bool(accepting.any())
