"""Combination of clauses in sequence: the goal of each step, and how long its rules last."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Container, Iterator, Sequence

from edge.mission.language.grammar.clause_parts import Count
from edge.mission.language.grammar.goal_tree import (
    AllOf,
    AnyOf,
    Goal,
    InSequence,
    Visit,
    at_most,
    at_most_before,
    held_until,
    last_names,
    names_in,
    never,
    steps,
    visits,
)
from edge.mission.language.grammar.meaning import ClauseMeaning
from edge.mission.language.words.noun_phrases import NounPhrase
from edge.mission.language.words.tokens import Token, TokenReader
from edge.mission.logic.ltl import Formula


def sequence_goal(sequence: Sequence[ClauseMeaning], reader: TokenReader) -> Goal:
    """Return the goal of a sequence of steps with their rules."""
    parts: list[Goal] = []
    rules: list[Formula] = []
    for i, meaning in enumerate(sequence):
        after = sequence[i + 1 :]
        # A list with commas only is in order if a step follows: "a, b, then c".
        parts += _in_order(meaning) if after else meaning.goals and [_together(meaning.goals)]
        rules += meaning.rules
        rules += _rules_of_bans(meaning, sequence[:i], after)
        rules += _rules_of_withouts(meaning, after, reader)
        rules += _rules_of_limits(meaning, after, reader)
    return AllOf((steps(parts),) if parts else (), tuple(rules))


def anchor_goals(
    meaning: ClauseMeaning, sequence: Sequence[ClauseMeaning], asked: Container[str], then: bool
) -> None:
    """Put a clause's goals after its anchors, the objects that it names as earlier.

    "Go to a, and go to b after that" refers to the visit to a that was already asked for. It moves
    from the last step to the front of this clause's goals.
    """
    for anchor in meaning.anchors:
        asked_names = set(anchor.names)
        if then and all(name in asked for name in asked_names):
            continue
        before: list[Goal] = [visits(anchor)]
        if sequence and not then:
            meant = [goal for goal in sequence[-1].goals if names_in(goal) & asked_names]
            if asked_names <= frozenset().union(*map(names_in, meant)) and all(
                last_names(goal) <= asked_names for goal in meant
            ):
                sequence[-1].goals = [g for g in sequence[-1].goals if g not in meant]
                before = [_together(meant)]
        meaning.goals = [steps([*before, _together(meaning.goals)])]


def put_first(meaning: ClauseMeaning, sequence: list[ClauseMeaning], of_all: bool) -> None:
    """Make a clause the first step, or the step before the last one.

    "Visit the sofa and the desk, but the desk first" asks for one visit to the desk.
    """
    place = 0 if of_all else len(sequence) - 1
    _leave_out(meaning, sequence[place])
    sequence.insert(place, meaning)


def put_last(meaning: ClauseMeaning, sequence: Sequence[ClauseMeaning]) -> None:
    """Remove the goals of a last clause from the step before: `visit a and b, but visit b last`."""
    _leave_out(meaning, sequence[-1])


def _leave_out(meaning: ClauseMeaning, step: ClauseMeaning) -> None:
    """Remove from a step the goals that a clause repeats, unless nothing would be left."""
    asked_names = frozenset(meaning.targets.names)
    step.goals = [
        part for part in _flat_goals(step) if not names_in(part) <= asked_names
    ] or step.goals


def _flat_goals(step: ClauseMeaning) -> list[Goal]:
    """Return the goals of a step, with its sets flattened."""
    return [
        part
        for goal in step.goals
        for part in (goal.goals if isinstance(goal, AllOf) and not goal.rules else (goal,))
    ]


def _unwrap(goal: Goal) -> tuple[Goal, tuple[Formula, ...]]:
    """Return the only goal of nested sets with one goal, and the rules of these sets."""
    outer_rules: tuple[Formula, ...] = ()
    while isinstance(goal, AllOf) and len(goal.goals) == 1:
        outer_rules, goal = (*outer_rules, *goal.rules), goal.goals[0]
    return goal, outer_rules


def order_before_return(goal: Goal, meaning: ClauseMeaning) -> Goal:
    """Return the goal with a before b, for a return to a: `go to a. go to b. return to a.`."""
    asked_names = frozenset(meaning.targets.names)
    inner, outer_rules = _unwrap(goal)
    parts = inner.goals if isinstance(inner, AllOf) else ()
    start = tuple(part for part in parts if names_in(part) & asked_names)
    rest = tuple(part for part in parts if not names_in(part) & asked_names)
    if not (isinstance(inner, AllOf) and start and rest):
        return goal
    return AllOf((steps([AllOf(start), AllOf(rest)]),), (*outer_rules, *inner.rules))


def remove_last_goals(goal: Goal, meaning: ClauseMeaning) -> Goal:
    """Return the goal without its last clause: `visit a and b. b comes last.`."""
    asked_names = frozenset(meaning.targets.names)
    inner, outer_rules = _unwrap(goal)
    parts = inner.goals if isinstance(inner, AllOf) else ()
    rest = tuple(part for part in parts if not names_in(part) <= asked_names)
    return AllOf(rest, (*outer_rules, *inner.rules)) if isinstance(inner, AllOf) and rest else goal


def split_return(meaning: ClauseMeaning, sequence: list[ClauseMeaning]) -> None:
    """Put a before b for the return to a: `visit a, go to b, and return to a`."""
    asked_names = frozenset(meaning.targets.names)
    goals = _flat_goals(sequence[0])
    start = [goal for goal in goals if names_in(goal) & asked_names]
    rest = [goal for goal in goals if not names_in(goal) & asked_names]
    if start and rest:
        sequence[0].goals = [steps([_together(start), _together(rest)])]


def insert_detour(goal: Goal, passed: Goal, token: Token, reader: TokenReader) -> Goal:
    """Put a detour to b before the last step: `go to a. on the way, go to b`."""
    goal, outer_rules = _unwrap(goal)
    parts = goal.goals if isinstance(goal, InSequence) else (goal,)
    if not isinstance(parts[-1], Visit):
        reader.refuse("unclear where to; say 'on the way to …'", token)
    return AllOf((steps([*parts[:-1], passed, parts[-1]]),), outer_rules)


def repeat_visit(
    step: ClauseMeaning, targets: NounPhrase, count: Count, token: Token, reader: TokenReader
) -> None:
    """Repeat the last visit of a step: "go to a, leave it and repeat this twice more"."""
    visit = step.goals[-1] if step.goals else None
    if (
        len(targets.groups) != 1
        or not isinstance(visit, Visit)
        or visit.options != targets.groups[0]
    ):
        reader.refuse("use two sentences", token)
    # `count` includes the last of the visits that the step has already.
    step.goals[-1] = Visit(visit.options, visit.times - 1 + count.least)
    if count.most is not None:
        step.limits.append((visit.options, visit.times - 1 + count.most, None))


def rules_of_only_then(before: ClauseMeaning, after: ClauseMeaning) -> list[Formula]:
    """Return the rules of `x, only then y`: y not before x."""
    return held_until(after.targets.names, before.targets)


def rules_of_each_at_most(goal: Goal, n: int, token: Token, reader: TokenReader) -> list[Formula]:
    """Return the rules of `…; visit each place only once`.

    In a sequence, each limit lasts until the next step, if that is a single visit.
    """
    if isinstance(goal, Visit):
        return [at_most(goal.options, n)]
    if isinstance(goal, AnyOf):
        reader.refuse("say it for each alternative", token)
    visited = Counter(name for visit in single_visits(goal) for name in visit.options)
    if visited.most_common(1)[0][1] > 1:
        reader.refuse("one object is asked for more often; put all visits in one list", token)
    if isinstance(goal, AllOf):
        return [
            rule for part in goal.goals for rule in rules_of_each_at_most(part, n, token, reader)
        ]
    rules: list[Formula] = []
    for i, part in enumerate(goal.goals):
        before = goal.goals[i - 1] if i else None
        after = goal.goals[i + 1] if i + 1 < len(goal.goals) else None
        for visit in single_visits(part):
            if visit.times > n:
                reader.refuse("one object is asked for more often", token)
            in_turn = n == 1 and isinstance(before, Visit)
            if in_turn:  # its only visit comes after the one before
                rules += held_until(visit.options, NounPhrase((before.options,)))
            if isinstance(after, Visit):
                rules.append(at_most_before(visit.options, n, after.options))
            elif after is not None or not in_turn:
                rules.append(at_most(visit.options, n))
    return rules


def rules_of_strict_order(goal: Goal, token: Token, reader: TokenReader) -> list[Formula]:
    """Return the rules of `…; no place out of turn`: each step only after all of the one before."""
    goal, _ = _unwrap(goal)
    if not isinstance(goal, InSequence):
        reader.refuse("an order goes with a list: 'visit a, then b'", token)
    return [
        rule
        for before, after in itertools.pairwise(goal.goals)
        for visit in single_visits(before)
        for rule in held_until(names_in(after), NounPhrase((visit.options,)))
    ]


def chain_waits(waits: Sequence[tuple[tuple[str, ...], NounPhrase]]) -> Goal | None:
    """Return a, then b, then c for `do not visit c until b, and do not visit b until a`.

    Return None if the waits are no such chain.
    """
    # Name → the name before it; `first` is the name without one before it.
    before = {name: until.names[0] for names, until in waits for name in names}
    single = all(len(names) == 1 and len(until.names) == 1 for names, until in waits)
    first = set(before.values()) - before.keys()
    if len(waits) < 2 or not single or len(before) < len(waits) or len(first) != 1:
        return None
    after = {earlier: name for name, earlier in before.items()}
    order = [*first]
    while order[-1] in after:
        order.append(after[order[-1]])
    return steps([Visit((name,)) for name in order]) if len(order) == len(waits) + 1 else None


def _together(goals: Sequence[Goal]) -> Goal:
    """Return the goals in any order as one goal."""
    return goals[0] if len(goals) == 1 else AllOf(tuple(goals))


def _in_order(meaning: ClauseMeaning) -> list[Goal]:
    """Return a step's goals; "a, b, then …" without "and" is already a sequence."""
    if not meaning.listed:
        return [_together(meaning.goals)] if meaning.goals else []
    return [
        part
        for goal in meaning.goals
        for part in (goal.goals if isinstance(goal, (AllOf, InSequence)) else (goal,))
    ]


def _rules_of_bans(
    meaning: ClauseMeaning, before: Sequence[ClauseMeaning], after: Sequence[ClauseMeaning]
) -> list[Formula]:
    """Return the rules of a step's bans.

    A ban is permanent. If this or another step asks for the same name, it lasts until its step is
    done.
    """
    asked = {name for step in (meaning, *after) for goal in step.goals for name in names_in(goal)}
    visited = {
        name: visit.times
        for step in before
        for goal in step.goals
        for visit in single_visits(goal)
        for name in visit.options
    }
    rules: list[Formula] = []
    for names in meaning.bans:
        for name in names:
            # The ban of a name that is asked for ends when the step's other objects are reached.
            own = NounPhrase(tuple(group for group in meaning.targets.groups if name not in group))
            if name in visited and own.groups:
                rules += [at_most_before([name], visited[name], end) for end in own.groups]
            elif name in asked and own.groups:
                rules += held_until([name], own)
            else:
                rules += never([name])
    return rules


def _rules_of_withouts(
    meaning: ClauseMeaning, after: Sequence[ClauseMeaning], reader: TokenReader
) -> list[Formula]:
    """Return the rules of `go to x without y, then to z`: no y before x, or never y."""
    asked = {name for step in after for goal in step.goals for name in names_in(goal)}
    rules: list[Formula] = []
    for names, targets, token in meaning.withouts:
        ever = not asked & set(names) and reader.pick(token, 2)
        rules += never(names) if ever else held_until(names, targets)
    return rules


def single_visits(goal: Goal) -> Iterator[Visit]:
    """Yield the single visits of a goal."""
    if isinstance(goal, Visit):
        yield goal
    else:
        for part in goal.goals:
            yield from single_visits(part)


def _rules_of_limits(
    meaning: ClauseMeaning, after: Sequence[ClauseMeaning], reader: TokenReader
) -> list[Formula]:
    """Return the rules of a step's limits.

    A limit lasts until the next step if that is a single visit, else it is permanent. "Go to b but
    do not go to a again" may forbid a on the way to b only.
    """
    goals = after[0].goals if after else []
    ends = goals[0].options if len(goals) == 1 and isinstance(goals[0], Visit) else ()
    rules: list[Formula] = []
    for names, n, again in meaning.limits:
        own = [group for group in meaning.targets.groups if not set(group) & set(names)]
        if again and own and reader.pick(again, 2) == 0:
            rules += [at_most_before(names, n, group) for group in own]
        elif ends and not set(ends) & set(names):
            rules.append(at_most_before(names, n, ends))
        else:
            rules.append(at_most(names, n))
    return rules
