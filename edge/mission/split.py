"""A mission cut into parts that several robots may fulfil, each by itself and at any time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge.config import Mission
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import Formula
from edge.text import one_line


@dataclass(frozen=True)
class Split:
    """Parts, and what binds them together.

    Whatever words fulfil the parts, one a robot, any interleaving of them fulfils the whole.

    Attributes:
        parts: formulas for one robot each, every one with all avoidances in it; the whole alone
            where it cannot be cut.
        why_whole: why it cannot be, in one line; "" where it was.
    """

    parts: tuple[Formula, ...]
    why_whole: str = ""


def split(formula: Formula, limits: Mission | None = None) -> Split:
    """Cut a conjunction between conjuncts that share no proposition.

    Avoidances (`G !x`) are given to every part: a robot is kept from what it knows of only. All
    else must not care about steps in which nothing of its own is reached, since the others'
    steps are such to it: a part with `X` cannot be split off. What asks for nothing to be reached,
    such as `!a W b` without `F b`, stays with the first part.

    Args:
        limits: of compiling; the defaults where None.

    Raises:
        CompileError: a limit was passed.
    """
    conjuncts = formula.args if formula.op == "&" else (formula,)
    automata = [_compiled(part, limits or Mission()) for part in conjuncts]
    avoided = tuple(a.formula for a in automata if _avoids(a))
    parts, idle = [], []
    for group in _sharing(a.formula for a in automata if not _avoids(a)):
        automaton = _compiled(ltl.conj(*group), limits or Mission())
        if not _heeds_own_steps_only(automaton):
            return Split((formula,), f"{one_line(automaton.formula)} counts every step")
        (idle if automaton.accepting[0] else parts).append(automaton.formula)
    if len(parts) < 2:
        together = "its parts depend on each other" if len(conjuncts) > 1 else "it is of one part"
        return Split((formula,), together)
    parts[0] = ltl.conj(parts[0], *idle)
    return Split(tuple(ltl.conj(part, *avoided) for part in parts))


def _compiled(formula: Formula, limits: Mission) -> Automaton:
    return compile_formula(formula, limits.max_states, limits.compile_limit_steps, limits.compiler)


def _avoids(automaton: Automaton) -> bool:
    """Whether it is fulfilled as long as certain things are not reached, and asks nothing else."""
    delta, accepting = automaton.delta, automaton.accepting
    return bool(
        accepting[0]
        and automaton.n_states <= 2
        and delta[0, -1] == 0
        and not accepting[1:].any()
        and (delta[1:] == 1).all()
    )


def _heeds_own_steps_only(automaton: Automaton) -> bool:
    """Whether a step in which nothing of its own is reached changes nothing, wherever it is.

    The automaton is minimal, so that states which mean the same are the same.
    """
    return bool((automaton.delta[:, -1] == np.arange(automaton.n_states)).all())


def _sharing(formulas: Iterable[Formula]) -> list[list[Formula]]:
    """Formulas grouped by the propositions that they share, in order of first appearance."""
    given = list(formulas)
    groups: list[tuple[set[str], list[int]]] = []
    for k, formula in enumerate(given):
        names, members = set(ltl.propositions(formula)), [k]
        for group in [group for group in groups if group[0] & names]:
            groups.remove(group)
            names, members = names | group[0], [*group[1], *members]
        groups.append((names, sorted(members)))
    return [[given[k] for k in members] for _, members in sorted(groups, key=lambda g: g[1])]


def asked_for(formula: Formula, limits: Mission | None = None) -> tuple[str, ...]:
    """The propositions that may have to be reached: all but those that must never be."""
    automaton = _compiled(formula, limits or Mission())
    alive = [q for q in range(automaton.n_states) if not automaton.dead(q)]
    return tuple(
        letter
        for letter in automaton.letters
        if any(not automaton.dead(automaton.step(q, letter)) for q in alive)
    )
