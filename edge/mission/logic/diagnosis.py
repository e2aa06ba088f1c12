"""What is wrong with a formula before anything is driven: contradictions, empty demands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.mission.logic.automaton import Automaton
from edge.mission.logic.compiler import language
from edge.mission.logic.limits import MAX_STATES, MAX_STEPS, Effort
from edge.mission.logic.ltl import Formula, conj, propositions


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes:
        contradiction: conjuncts of the formula that no word fulfils together, while it could
            fulfil any of them that were left without one; empty where the formula can be
            fulfilled.
        tautology: every word fulfils the formula.
        unused: propositions whose being reached makes no difference to it.
    """

    contradiction: tuple[Formula, ...]
    tautology: bool
    unused: tuple[str, ...]


def diagnose(
    automaton: Automaton, max_states: int = MAX_STATES, max_steps: int = MAX_STEPS
) -> Diagnosis:
    """Look for what makes a formula pointless.

    Args:
        max_states, max_steps: limits of finding the conflict in a contradiction, all of its
            compilations together within `max_steps`.

    Raises:
        CompileError: a limit was passed.
    """
    nothing = automaton.delta[:, -1]
    unused = tuple(
        name
        for k, name in enumerate(automaton.letters)
        if np.array_equal(automaton.delta[:, k], nothing)
    )
    conflict: tuple[Formula, ...] = ()
    if not automaton.accepting.any():
        conflict = _conflict(automaton.formula, Effort(max_states, max_steps))
    return Diagnosis(conflict, bool(automaton.accepting.all()), unused)


def conjuncts(formula: Formula) -> tuple[Formula, ...]:
    """The formulas that a formula demands all of, in their order; nested conjunctions opened."""
    found: list[Formula] = []
    todo = [formula]
    while todo:
        f = todo.pop()
        if f.op == "&":
            todo.extend(reversed(f.args))
        else:
            found.append(f)
    return tuple(dict.fromkeys(found))


def _conflict(formula: Formula, effort: Effort) -> tuple[Formula, ...]:
    """A subset of the conjuncts that is contradictory, and would not be without any of them.

    Later conjuncts are dropped first, so what stays is what was said first.
    """
    kept = list(conjuncts(formula))
    for part in reversed(kept.copy()):
        fewer = [f for f in kept if f is not part]
        if fewer and not _possible(conj(*fewer), effort):
            kept = fewer
    return tuple(kept)


def _possible(formula: Formula, effort: Effort) -> bool:
    _, accepting = language(formula, propositions(formula), effort)
    return bool(accepting.any())
