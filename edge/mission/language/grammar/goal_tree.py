"""Goals of clauses, and their formulas: the grammar's result before it becomes a formula.

A goal is a tree of sequences, sets and alternatives of single visits. A rule is a formula that
holds from the start. Two conventions:

- "x, then y" is F(x & F y) as in ViTL, but F(x & X F y) if one visit could be both;
- "n times" counts separate visits: something else, or nothing, is reached between two of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Union

from edge.mission.language.words.noun_phrases import NounPhrase
from edge.mission.logic.ltl import (
    TRUE,
    Formula,
    always,
    ap,
    conj,
    disj,
    eventually,
    implies,
    neg,
    next_,
    weak_next,
    weak_until,
)

Goal = Union["Visit", "InSequence", "AllOf", "AnyOf"]


@dataclass(frozen=True, slots=True)
class Visit:
    """A number of separate visits to one of several objects."""

    options: tuple[str, ...]
    times: int = 1


@dataclass(frozen=True, slots=True)
class InSequence:
    """A sequence of goals, one after the other."""

    goals: tuple[Goal, ...]


@dataclass(frozen=True, slots=True)
class AllOf:
    """A set of goals in any order, with rules.

    Attributes:
        rules: formulas that hold from the start.
    """

    goals: tuple[Goal, ...]
    rules: tuple[Formula, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class AnyOf:
    """A choice of goals: at least one of them."""

    goals: tuple[Goal, ...]


def any_reached(names: Iterable[str]) -> Formula:
    """Return the formula "one of these is reached in this step"."""
    return disj(*map(ap, names))


def visits(targets: NounPhrase, times: int = 1) -> Goal:
    """Return the goal to visit all groups in any order."""
    goals = tuple(Visit(group, times) for group in targets.groups)
    return goals[0] if len(goals) == 1 else AllOf(goals)


def steps(goals: Sequence[Goal]) -> Goal:
    """Return the goals in sequence; nested sequences are flattened."""
    flat: list[Goal] = []
    for goal in goals:
        flat += goal.goals if isinstance(goal, InSequence) else (goal,)
    return flat[0] if len(flat) == 1 else InSequence(tuple(flat))


def names_in(goal: Goal) -> frozenset[str]:
    """Return every name in a goal."""
    if isinstance(goal, Visit):
        return frozenset(goal.options)
    return frozenset().union(*map(names_in, goal.goals))


def last_names(goal: Goal) -> frozenset[str]:
    """Return the names that may be reached last for a goal."""
    return names_in(goal.goals[-1]) if isinstance(goal, InSequence) else names_in(goal)


def formula_of(goal: Goal) -> Formula:
    """Return the formula of an entire instruction."""
    achieving = formula_of_goal(goal, TRUE, frozenset())
    asked = achieving.args if achieving.op == "&" else (achieving,)
    return conj(*(f for f in dict.fromkeys((*asked, *rules(goal))) if f != TRUE))


def rules(goal: Goal) -> list[Formula]:
    """Return the rules outside alternatives; those inside belong to their alternative."""
    if isinstance(goal, InSequence):
        return [rule for part in goal.goals for rule in rules(part)]
    if isinstance(goal, AllOf):
        return [*(rule for part in goal.goals for rule in rules(part)), *goal.rules]
    return []


def formula_of_goal(goal: Goal, tail: Formula, starts: frozenset[str]) -> Formula:
    """Return the formula "the goal is achieved at some time, and then `tail`", without rules."""
    if isinstance(goal, Visit):
        return _formula_of_visits(goal, tail, starts)
    if isinstance(goal, InSequence):
        for part in reversed(goal.goals):
            tail, starts = formula_of_goal(part, tail, starts), _first_names(part)
        return tail
    if isinstance(goal, AllOf):
        parts = [formula_of_goal(part, tail, starts) for part in goal.goals]
        return conj(*(part for part in parts if part != TRUE)) if parts else tail
    return disj(*[conj(formula_of_goal(part, tail, starts), *rules(part)) for part in goal.goals])


def _formula_of_visits(goal: Visit, tail: Formula, starts: frozenset[str]) -> Formula:
    """Return the formula of visits, and then `tail`; see `formula_of_goal`."""
    here = any_reached(goal.options)
    if tail != TRUE and starts & set(goal.options):
        tail = next_(tail)  # otherwise one visit could fulfil both
    formula = eventually(here if tail == TRUE else conj(here, tail))
    for _ in range(goal.times - 1):
        formula = eventually(conj(here, eventually(conj(neg(here), formula))))
    return formula


def _first_names(goal: Goal) -> frozenset[str]:
    """Return the names that may be reached first for a goal."""
    if isinstance(goal, Visit):
        return frozenset(goal.options)
    if isinstance(goal, InSequence):
        return _first_names(goal.goals[0])
    return frozenset().union(*map(_first_names, goal.goals))


def held_until(names: Iterable[str], until: NounPhrase) -> list[Formula]:
    """Return `!x W y` for each name x and group y: no name before the objects are reached."""
    return [
        weak_until(neg(ap(name)), any_reached(group))
        for name in names
        for group in until.groups
        if name not in group
    ]


def never(names: Iterable[str]) -> list[Formula]:
    """Return G !x for each name."""
    return [always(neg(ap(name))) for name in names]


def never_after(names: Iterable[str], after: NounPhrase) -> list[Formula]:
    """Return the ban of the names after all of the objects are reached."""
    if len(after.groups) != 1:
        done = visits(after)
        return [
            neg(formula_of_goal(done, eventually(ap(name)), frozenset([name]))) for name in names
        ]
    group = after.groups[0]
    bans = {name: always(neg(ap(name))) for name in names}
    return [
        always(implies(any_reached(group), weak_next(ban) if name in group else ban))
        for name, ban in bans.items()
    ]


def at_most(names: Sequence[str], n: int) -> Formula:
    """Return the formula of at most n separate visits to one of the names."""
    return neg(formula_of_goal(Visit(tuple(names), n + 1), TRUE, frozenset()))


def at_most_before(names: Sequence[str], n: int, end: Sequence[str]) -> Formula:
    """Return the formula of at most n separate visits to the names before one of `end`."""
    here = any_reached(names)
    formula = weak_until(neg(here), any_reached(end))
    for _ in range(n):
        formula = weak_until(neg(here), weak_until(here, formula))
    return formula
