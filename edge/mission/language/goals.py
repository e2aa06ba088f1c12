"""What clauses ask for, and the formula of it.

A goal is a tree of sequences, sets and alternatives over single visits; a rule is a formula that
holds from the start on. Two readings are fixed here:

- "x, then y" is F(x & F y) as in ViTL, but F(x & X F y) where one visit could be both;
- "n times" counts separate visits: something else, or nothing, is reached between two of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Union

from edge.mission.language.things import Things
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

Goal = Union["Visit", "Steps", "Every", "Some"]


@dataclass(frozen=True, slots=True)
class Visit:
    """One of these, so many separate times."""

    options: tuple[str, ...]
    times: int = 1


@dataclass(frozen=True, slots=True)
class Steps:
    """One after the other."""

    goals: tuple[Goal, ...]


@dataclass(frozen=True, slots=True)
class Every:
    """All of them, in any order, while the rules hold."""

    goals: tuple[Goal, ...]
    rules: tuple[Formula, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class Some:
    """One of them at least."""

    goals: tuple[Goal, ...]


def any_of(names: Iterable[str]) -> Formula:
    """One of these is reached in this step."""
    return disj(*map(ap, names))


def visits(things: Things, times: int = 1) -> Goal:
    """All of the things in any order."""
    goals = tuple(Visit(group, times) for group in things.groups)
    return goals[0] if len(goals) == 1 else Every(goals)


def steps(goals: Sequence[Goal]) -> Goal:
    """One after the other, sequences within them joined on."""
    flat: list[Goal] = []
    for goal in goals:
        flat += goal.goals if isinstance(goal, Steps) else (goal,)
    return flat[0] if len(flat) == 1 else Steps(tuple(flat))


def letters(goal: Goal) -> frozenset[str]:
    """Every name in a goal."""
    if isinstance(goal, Visit):
        return frozenset(goal.options)
    return frozenset().union(*map(letters, goal.goals))


def last_letters(goal: Goal) -> frozenset[str]:
    """What may be reached last on the way to a goal."""
    return letters(goal.goals[-1]) if isinstance(goal, Steps) else letters(goal)


def formula_of(goal: Goal) -> Formula:
    """The formula of a whole instruction."""
    achieving = achieved(goal, TRUE, frozenset())
    asked = achieving.args if achieving.op == "&" else (achieving,)
    return conj(*(f for f in dict.fromkeys((*asked, *rules(goal))) if f != TRUE))


def rules(goal: Goal) -> list[Formula]:
    """Rules that hold whichever way the goal is achieved; those of alternatives are theirs."""
    if isinstance(goal, Steps):
        return [rule for part in goal.goals for rule in rules(part)]
    if isinstance(goal, Every):
        return [*(rule for part in goal.goals for rule in rules(part)), *goal.rules]
    return []


def achieved(goal: Goal, tail: Formula, starts: frozenset[str]) -> Formula:
    """The goal is achieved at some time, and then `tail`, which begins with one of `starts`."""
    if isinstance(goal, Visit):
        return _visited(goal, tail, starts)
    if isinstance(goal, Steps):
        for part in reversed(goal.goals):
            tail, starts = achieved(part, tail, starts), _first_letters(part)
        return tail
    if isinstance(goal, Every):
        parts = [achieved(part, tail, starts) for part in goal.goals]
        return conj(*(part for part in parts if part != TRUE)) if parts else tail
    return disj(*[conj(achieved(part, tail, starts), *rules(part)) for part in goal.goals])


def _visited(goal: Visit, tail: Formula, starts: frozenset[str]) -> Formula:
    here = any_of(goal.options)
    if tail != TRUE and starts & set(goal.options):
        tail = next_(tail)
    formula = eventually(here if tail == TRUE else conj(here, tail))
    for _ in range(goal.times - 1):
        formula = eventually(conj(here, eventually(conj(neg(here), formula))))
    return formula


def _first_letters(goal: Goal) -> frozenset[str]:
    """What may be reached first on the way to a goal."""
    if isinstance(goal, Visit):
        return frozenset(goal.options)
    if isinstance(goal, Steps):
        return _first_letters(goal.goals[0])
    return frozenset().union(*map(_first_letters, goal.goals))


def held_until(names: Iterable[str], until: Things) -> list[Formula]:
    """None of the names before each of the things: the weak until `!x W y`."""
    return [
        weak_until(neg(ap(name)), any_of(group))
        for name in names
        for group in until.groups
        if name not in group
    ]


def never(names: Iterable[str]) -> list[Formula]:
    """G !x for each."""
    return [always(neg(ap(name))) for name in names]


def never_after(names: Iterable[str], after: Things) -> list[Formula]:
    """Once all of the things are reached, none of the names any more."""
    if len(after.groups) != 1:
        done = visits(after)
        return [neg(achieved(done, eventually(ap(name)), frozenset([name]))) for name in names]
    group = after.groups[0]
    bans = {name: always(neg(ap(name))) for name in names}
    return [
        always(implies(any_of(group), weak_next(ban) if name in group else ban))
        for name, ban in bans.items()
    ]


def at_most(names: Sequence[str], n: int) -> Formula:
    """At most n separate visits to one of the names."""
    return neg(achieved(Visit(tuple(names), n + 1), TRUE, frozenset()))


def at_most_before(names: Sequence[str], n: int, end: Sequence[str]) -> Formula:
    """At most n separate visits until one of `end` is reached after them."""
    here = any_of(names)
    formula = weak_until(neg(here), any_of(end))
    for _ in range(n):
        formula = weak_until(neg(here), weak_until(here, formula))
    return formula
