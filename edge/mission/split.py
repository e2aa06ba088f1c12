"""Decomposition of a mission into parts for several robots, without coordination between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import Formula
from edge.text import one_line


@dataclass(frozen=True)
class MissionSplit:
    """The parts of a mission, one for each robot.

    If each robot's trace fulfils its part, any interleaving of the traces fulfils the mission.

    Attributes:
        parts: one formula for each robot, each with all avoidances. If the formula cannot be
            split, it is the only part.
        unsplit_reason: why the formula cannot be split, in one line; "" if it was split.
    """

    parts: tuple[Formula, ...]
    unsplit_reason: str = ""


def split(formula: Formula) -> MissionSplit:
    """Split a conjunction between conjuncts that share no proposition.

    Every part gets all avoidances (`G !x`), because a robot respects only its own formula. A part
    must not depend on steps in which none of its objects is reached: these include the steps
    of other robots. So a part with `X` cannot be split off. A conjunct that requires no object,
    such as `!a W b` without `F b`, stays with the first part.

    Raises:
        CompileError: a limit was exceeded.

    Example:
        >>> from edge.mission.logic.ltl import parse
        >>> [str(part) for part in split(parse("F bed & F sofa & G !dog")).parts]
        ['F bed & G !dog', 'F sofa & G !dog']
    """
    conjuncts = formula.args if formula.op == "&" else (formula,)
    automata = [compile_formula(part) for part in conjuncts]
    avoided = tuple(a.formula for a in automata if _is_avoidance(a))
    parts: list[Formula] = []
    undemanding: list[Formula] = []  # fulfilled without reaching anything
    for group in _group_by_propositions(a.formula for a in automata if not _is_avoidance(a)):
        automaton = compile_formula(ltl.conj(*group))
        if not _ignores_other_steps(automaton):
            return MissionSplit(
                (formula,), f"{one_line(automaton.formula)} counts other robots' steps"
            )
        (undemanding if automaton.accepting[0] else parts).append(automaton.formula)
    if len(parts) < 2:
        why = "its parts depend on each other" if len(conjuncts) > 1 else "it has one part"
        return MissionSplit((formula,), why)
    parts[0] = ltl.conj(parts[0], *undemanding)
    return MissionSplit(tuple(ltl.conj(part, *avoided) for part in parts))


def _is_avoidance(automaton: Automaton) -> bool:
    """Return True if the automaton only forbids reaching some objects."""
    delta, accepting = automaton.delta, automaton.accepting
    # State 0 accepts and stays in a step without an object. State 1, if any, is dead.
    return bool(
        accepting[0]
        and automaton.n_states <= 2
        and delta[0, -1] == 0
        and not accepting[1:].any()
        and (delta[1:] == 1).all()
    )


def _ignores_other_steps(automaton: Automaton) -> bool:
    """Return True if a step that reaches none of the automaton's objects never changes its state.

    The automaton is minimal, so a state that means the same is the same state. The last column of
    `delta` is the step that reaches no object.
    """
    return bool((automaton.delta[:, -1] == np.arange(automaton.n_states)).all())


def _group_by_propositions(formulas: Iterable[Formula]) -> list[list[Formula]]:
    """Group formulas that share propositions, in order of first appearance."""
    given = list(formulas)
    groups: list[tuple[set[str], list[int]]] = []
    for k, formula in enumerate(given):
        names, members = set(ltl.propositions(formula)), [k]
        for group in [group for group in groups if group[0] & names]:
            groups.remove(group)
            names, members = names | group[0], [*group[1], *members]
        groups.append((names, sorted(members)))
    return [[given[k] for k in members] for _, members in sorted(groups, key=lambda g: g[1])]


def required_propositions(formula: Formula) -> tuple[str, ...]:
    """Return the propositions that may have to be reached: all except the forbidden ones."""
    return compile_formula(formula).possible
