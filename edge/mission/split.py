"""Decomposition of a mission into parts for several robots, without coordination between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge.config import MissionConfig
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import Formula
from edge.text import one_line


@dataclass(frozen=True)
class MissionSplit:
    """The parts of a mission, one for each robot.

    If each robot's trace fulfils its part, any interleaving of the traces fulfils the whole.

    Attributes:
        parts: one formula for each robot, each with all avoidances. Only the whole formula if it
            cannot be split.
        unsplit_reason: why the formula cannot be split, in one line; "" if it was split.
    """

    parts: tuple[Formula, ...]
    unsplit_reason: str = ""


def split(formula: Formula, limits: MissionConfig | None = None) -> MissionSplit:
    """Split a conjunction between conjuncts that share no proposition.

    Every part gets all avoidances (`G !x`), because a robot respects only its own formula. A part
    must not depend on steps in which none of its objects is reached: these include the steps
    of other robots. So a part with `X` cannot be split off. A conjunct that requires no object,
    such as `!a W b` without `F b`, stays with the first part.

    Args:
        formula: the mission.
        limits: compiler limits; the defaults if None.

    Raises:
        CompileError: a limit was exceeded.

    Example:
        >>> from edge.mission.logic.ltl import parse
        >>> [str(part) for part in split(parse("F bed & F sofa & G !dog")).parts]
        ['F bed & G !dog', 'F sofa & G !dog']
    """
    conjuncts = formula.args if formula.op == "&" else (formula,)
    automata = [_compiled(part, limits or MissionConfig()) for part in conjuncts]
    avoided = tuple(a.formula for a in automata if _avoids(a))
    parts, idle = [], []
    for group in _sharing(a.formula for a in automata if not _avoids(a)):
        automaton = _compiled(ltl.conj(*group), limits or MissionConfig())
        if not _heeds_own_steps_only(automaton):
            return MissionSplit(
                (formula,), f"{one_line(automaton.formula)} counts other robots' steps"
            )
        (idle if automaton.accepting[0] else parts).append(automaton.formula)
    if len(parts) < 2:
        together = "its parts depend on each other" if len(conjuncts) > 1 else "it has one part"
        return MissionSplit((formula,), together)
    parts[0] = ltl.conj(parts[0], *idle)
    return MissionSplit(tuple(ltl.conj(part, *avoided) for part in parts))


def _compiled(formula: Formula, limits: MissionConfig) -> Automaton:
    """Return the automaton of a formula within the limits of a configuration."""
    return compile_formula(formula, limits.max_states, limits.compile_limit_steps, limits.compiler)


def _avoids(automaton: Automaton) -> bool:
    """Return True if the automaton only forbids reaching some objects."""
    delta, accepting = automaton.delta, automaton.accepting
    return bool(
        accepting[0]
        and automaton.n_states <= 2
        and delta[0, -1] == 0
        and not accepting[1:].any()
        and (delta[1:] == 1).all()
    )


def _heeds_own_steps_only(automaton: Automaton) -> bool:
    """Return True if a step that reaches none of the automaton's objects never changes its state.

    The automaton is minimal, so equal meaning implies equal state.
    """
    return bool((automaton.delta[:, -1] == np.arange(automaton.n_states)).all())


def _sharing(formulas: Iterable[Formula]) -> list[list[Formula]]:
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


def required_propositions(formula: Formula, limits: MissionConfig | None = None) -> tuple[str, ...]:
    """Return the propositions that may have to be reached: all except the forbidden ones."""
    return _compiled(formula, limits or MissionConfig()).possible
