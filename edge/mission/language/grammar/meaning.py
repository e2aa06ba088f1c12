"""Meaning of one clause: goals, and rules for the entire mission.

A count is a range of separate visits. `reader.pick(token, n)` asks for one of n meanings of an
ambiguous token, see `grammar.readings`; 0 is the usual meaning.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from edge.mission.language.grammar.clause_parts import Clause, Condition, Count
from edge.mission.language.grammar.goal_tree import (
    AllOf,
    Goal,
    any_reached,
    at_most,
    at_most_before,
    formula_of,
    held_until,
    never,
    never_after,
    steps,
    visits,
)
from edge.mission.language.words.noun_phrases import NounPhrase
from edge.mission.language.words.tokens import Token, TokenReader
from edge.mission.logic.ltl import Formula, always, ap, implies, neg, next_, weak_next


@dataclass(slots=True)
class ClauseMeaning:
    """Goals and rules of a clause, or of several clauses joined by "and"."""

    goals: list[Goal] = field(default_factory=list)  # goals to achieve in any order
    # objects of the goals; "while avoiding" lasts until they are reached
    targets: NounPhrase = field(default_factory=lambda: NounPhrase(()))
    rules: list[Formula] = field(default_factory=list)  # formulas that hold from the start
    # names not to be reached; their duration is decided when the sequence is complete
    bans: list[tuple[str, ...]] = field(default_factory=list)
    # (names, objects, token) of "go to the targets without the names", if more follows. Unless the
    # sequence later asks for the names, the user is asked if the ban is permanent
    withouts: list[tuple[tuple[str, ...], NounPhrase, Token]] = field(default_factory=list)
    # (names, n, token): at most n separate visits to the names, in a sequence until the next step.
    # The token is that of "not again", which may apply only on the way to `targets`; else None
    limits: list[tuple[tuple[str, ...], int, Token | None]] = field(default_factory=list)
    # (names, objects): none of the names before the objects; also in `rules`
    waits: list[tuple[tuple[str, ...], NounPhrase]] = field(default_factory=list)
    listed: bool = True  # True if the goals are a list without "and"
    follows: bool = False  # True if the clause comes after the step before it
    repeats: bool = False  # True if the clause asks for the same visit as the last one
    commas: bool = False  # True if the orders are joined only by commas
    returns: bool = False  # True if the clause goes back to an earlier goal
    anchors: list[NounPhrase] = field(default_factory=list)  # objects after which the goals come
    each: int | None = None  # limit of visits to each place in the entire instruction
    strictly: bool = False  # True if the order of the entire instruction is strict

    @property
    def loose(self) -> bool:
        """True if there are rules only, no goal."""
        return not self.goals

    def ban_after(self, targets: NounPhrase) -> None:
        """Let the bans begin when the objects are reached."""
        self.rules += [f for names in self.bans for f in never_after(names, targets)]
        self.bans = []

    def limit_for_good(self) -> None:
        """Make the limits permanent: given before a step, they are not part of that step."""
        self.rules += [at_most(names, n) for names, n, again in self.limits if not again]
        self.limits = [limit for limit in self.limits if limit[2]]

    def add(self, other: ClauseMeaning, joint_kind: str = "") -> None:
        """Add another meaning: both apply. The kind of the joint is `and`, `comma`, … or ""."""
        if self.goals and other.goals:
            self.listed = self.listed and joint_kind in ("", "comma")
            self.commas = joint_kind == "comma"
        self.goals += other.goals
        self.targets = NounPhrase(self.targets.groups + other.targets.groups)
        self.rules += other.rules
        self.bans += other.bans
        self.withouts += other.withouts
        self.limits += other.limits


def meaning_of(clause: Clause, reader: TokenReader, times: Mapping[str, int]) -> ClauseMeaning:
    """Return the meaning of a clause.

    `times` is the number of visits so far, by name, for "do not visit it again".

    Raises:
        TranslationError: parts of the clause do not fit together.
    """
    if clause.only and clause.count and clause.count.most is None:
        clause.count = Count(clause.count.least, clause.count.least)
    elif clause.only and clause.conditions:
        clause.conditions = [replace(condition, only=True) for condition in clause.conditions]
    elif clause.only and not clause.count and not clause.negated:
        hint = "'only' needs a number or a condition; say what to avoid"
        reader.refuse_finally(hint, clause.token)
    if clause.targets is None:
        return _goal_of_until(clause, reader)
    if clause.instant and not clause.conditions:
        reader.refuse("'in the next step' is not possible here", clause.instant)
    again = clause.again and not (clause.negated or clause.count or clause.conditions)
    if again and not clause.returns and not times.keys() & set(clause.targets.names):
        hint = "this was not asked for before, so 'again' is unclear; say how often"
        reader.refuse(hint, clause.token)
    if clause.targets.every and (meaning := _meaning_of_every(clause, clause.targets, reader)):
        return meaning
    # One object has no order.
    alone = len(clause.targets.groups) + len(clause.route) < 2 and not clause.negated
    if alone and (clause.order == "strict order" or (clause.order and clause.conditions)):
        reader.refuse("an order goes with a list: 'visit a, b and c in this order'", clause.token)
    if clause.out_of_turn:
        reader.refuse("say for which places", clause.token)
    meaning_of_kind = _meaning_of_ban if clause.negated else _meaning_of_order
    meaning = meaning_of_kind(clause, clause.targets, reader, times)
    meaning.each = clause.each or meaning.each
    meaning.bans += [targets.names for targets in clause.never]
    return meaning


def _meaning_of_every(
    clause: Clause, targets: NounPhrase, reader: TokenReader
) -> ClauseMeaning | None:
    """Return the meaning of `visit each place only once`, `never go back to any of them`."""
    if clause.out_of_turn:
        return ClauseMeaning(strictly=True)
    if clause.each or (clause.negated and (clause.again or clause.returns)):
        return ClauseMeaning(each=1)
    if clause.count and clause.count.most and clause.count.least < 2:
        return ClauseMeaning(each=clause.count.most)
    if targets.every == "places" or not targets.groups:
        reader.refuse("say which", clause.token)
    return None


def permission_of(clause: Clause) -> NounPhrase | None:
    """Return the objects that a clause only allows: those of its condition, or its own."""
    if clause.mood != "can" or clause.negated or clause.count:
        return None
    return clause.conditions[-1].targets if clause.conditions else clause.targets


def _goal_of_until(clause: Clause, reader: TokenReader) -> ClauseMeaning:
    """Return the meaning of `do not stop until a and b are visited`."""
    if len(clause.conditions) != 1 or clause.conditions[0].kind != "until":
        reader.refuse("say until when, as in 'do not stop until the bed is reached'", clause.token)
    targets = clause.conditions[0].targets
    return ClauseMeaning([visits(targets)], targets)


def _meaning_of_ban(
    clause: Clause, targets: NounPhrase, reader: TokenReader, times: Mapping[str, int]
) -> ClauseMeaning:
    """Return the meaning of `do not visit x …`, `avoid x …`, `never visit x more than twice`."""
    meaning = ClauseMeaning()
    if clause.order:
        reader.refuse("an order is not possible for forbidden objects", clause.token)
    if clause.not_again:
        reader.refuse_finally("use two sentences", clause.token)
    for avoided in clause.avoiding:  # "do not visit b without visiting a"
        meaning.rules += held_until(targets.names, avoided)
    if clause.count:  # "never visit a more than twice"
        _add_count(clause, targets, clause.count, meaning, times)
        for condition in clause.conditions:
            reader.refuse("a count and a condition cannot be combined", condition.token)
    elif _is_again(clause, targets, times) and not (
        clause.conditions or set(targets.names) <= set(times)
    ):
        reader.refuse_finally("this was not asked for before; say 'never …'", clause.token)
    elif _is_again(clause, targets, times) and all(
        c.targets.names == targets.names for c in clause.conditions
    ):
        # At most as many visits as were asked for; else the condition says how many.
        for name in targets.names:
            most = times.get(name, 1)
            for condition in clause.conditions:
                most = condition.count.least if condition.count else most
            meaning.limits.append(((name,), most, None if clause.conditions else clause.token))
    elif clause.conditions:  # "do not visit a before b"
        for condition in clause.conditions:
            meaning.rules += _rules_of_ban(clause, targets, condition, reader)
            if condition.kind in ("before", "until"):
                meaning.waits.append((targets.names, condition.targets))
    elif not clause.avoiding:
        meaning.bans.append(targets.names)
    return meaning


def _is_again(clause: Clause, targets: NounPhrase, times: Mapping[str, int]) -> bool:
    """Return True if the clause forbids a second visit: "never go back to it"."""
    if clause.returns:
        return all(name in times for name in targets.names)
    return clause.again


def _rules_of_ban(
    clause: Clause, targets: NounPhrase, condition: Condition, reader: TokenReader
) -> list[Formula]:
    """Return the rules of `do not visit x before y`, `never visit x after y` and the like."""
    if condition.targets.names != targets.names:
        _refuse_count_in_condition(condition, reader)
    elif condition.only:
        reader.refuse_finally("nothing comes before or after itself", condition.token)
    if condition.kind in ("before", "until", "unless") or condition.denied:
        rules = held_until(targets.names, condition.targets)
        if not rules:
            reader.refuse_finally("nothing can come before itself", condition.token)
        return rules
    if condition.going:
        reader.refuse("say 'after …' or 'on the way to …'", condition.token)
    if clause.next_step:
        return [
            always(implies(any_reached(group), weak_next(neg(ap(name)))))
            for name in targets.names
            for group in condition.targets.groups
        ]
    return never_after(targets.names, condition.targets)


def _refuse_count_in_condition(condition: Condition, reader: TokenReader) -> None:
    if condition.count and condition.count != Count(1):
        reader.refuse("a condition cannot count visits", condition.token)


def _add_count(
    clause: Clause,
    targets: NounPhrase,
    count: Count,
    meaning: ClauseMeaning,
    times: Mapping[str, int],
) -> None:
    """Add goals and limits of a count; "…; visit a only once" asks for no additional visit."""
    asked = all(times.get(n, 0) >= count.least for n in targets.names) and count.most is not None
    if count.least and not asked and (clause.negated or clause.mood != "can"):
        meaning.goals.append(visits(targets, count.least))
        meaning.targets = targets
    if count.most is not None:
        meaning.limits += [(group, count.most, None) for group in targets.groups]


def _meaning_of_order(
    clause: Clause, targets: NounPhrase, reader: TokenReader, times: Mapping[str, int]
) -> ClauseMeaning:
    """Return the meaning of `visit x …`, `you must visit x …`, `you can visit x …`."""
    meaning = ClauseMeaning()
    # "visit a at most twice until b"
    if clause.count and [c for c in clause.conditions if c.kind in ("until", "before")]:
        return _meaning_of_count_until(clause, targets, clause.count, reader, times)
    if clause.count and len(targets.groups) > 1 and clause.order:  # "a, b in order, once each"
        least = clause.count.least
        meaning.goals.append(steps([visits(NounPhrase((g,)), least) for g in targets.groups]))
        meaning.each = 1 if clause.count.most == 1 else None
        meaning.targets = targets
    elif clause.count:
        _add_count(clause, targets, clause.count, meaning, times)
    elif clause.mood != "can" or any(c.only and c.denied for c in clause.conditions):
        meaning.goals.append(steps([visits(step) for step in _steps_of(clause, targets)]))
        meaning.targets = targets
    if clause.count and clause.route:
        reader.refuse_finally("unclear if the path is counted too; use two sentences", clause.token)
    if clause.order == "strict order":  # "visit a and b in exactly this order"
        for before, after in itertools.pairwise(_steps_of(clause, targets)):
            meaning.rules += held_until(after.names, before)
    # "go to b only through a"
    if clause.only_way and reader.pick(reader.tokens[-1], 2) == 1:
        meaning.rules += held_until(targets.names, NounPhrase(clause.route[-1].groups))
    # "Visit a without b": the ban ends at a, or is permanent if nothing comes before or after.
    last = reader.is_at("end") or reader.is_at("end", ahead=1)
    alone = last and (clause.during or not times)
    for avoided in (*clause.avoiding, *clause.not_first):
        passed = {name for step in clause.route for name in step.names}
        if set(avoided.names) & {*targets.names, *passed}:
            reader.refuse_finally("the same object is asked for and to be avoided", clause.token)
    for avoided in clause.avoiding:
        others = [n for n in avoided.names if n not in times]
        if (clause.during and not alone) or set(others) & set(targets.names):
            meaning.rules += held_until(others, targets)
        elif alone:
            meaning.rules += never(others)  # nothing follows, so the safer reading costs nothing
        else:
            meaning.withouts.append((tuple(others), targets, clause.token))
    for avoided in clause.not_first:  # "without visiting b first"
        meaning.rules += held_until(avoided.names, targets)
    # Names that were visited before: no further visit until the goal.
    for avoided in (*clause.not_again, *clause.avoiding):
        again = [n for n in avoided.names if n in times or avoided in clause.not_again]
        meaning.rules += [
            at_most_before([name], times.get(name, 1), end)
            for name in again
            for end in targets.groups
        ]
    for condition in clause.conditions:
        _add_condition(clause, targets, condition, reader, meaning)
    several = len(targets.groups) > 1
    meaning.listed = (targets.listed or not several) and not clause.order
    return meaning


def _steps_of(clause: Clause, targets: NounPhrase) -> list[NounPhrase]:
    """Return the goals of a clause in their order."""
    ordered_steps = [*clause.route, targets]
    if clause.order in ("in order", "strict order"):
        return [NounPhrase((group,)) for step in ordered_steps for group in step.groups]
    return ordered_steps


_END_VERBS = ("end ", "ends ", "ending ", "finish")  # beginnings of verbs that end a mission
_DUTY_STARTS = ("make sure", "making sure", "ensur", "be sure", "see to it")  # beginnings of duties
_BEFORE_READINGS = ("both", "first only", "in order")
"""Readings of "x before y" as a rule: both, and no y before x; x, and no y before it; x, then y.
As a plain order it asks for both, which implies the others and is driven like "x, then y".
"""


def _meaning_of_count_until(
    clause: Clause, targets: NounPhrase, count: Count, reader: TokenReader, times: Mapping[str, int]
) -> ClauseMeaning:
    """Return the meaning of `reach x at most twice until y is reached`."""
    meaning = ClauseMeaning()
    most = count.most
    asked = all(times.get(name, 0) >= count.least for name in targets.names)
    if clause.conditions[0].kind == "before" and not asked:
        reader.refuse("use two sentences", clause.token)
    if len(clause.conditions) != 1 or most is None:
        reader.refuse("only 'at most … times' can have an 'until'", clause.token)
    if not asked:
        _add_count(clause, targets, Count(count.least), meaning, times)
    meaning.rules += [
        at_most_before(group, most, end)
        for group in targets.groups
        for end in clause.conditions[0].targets.groups
    ]
    return meaning


def _add_condition(
    clause: Clause,
    targets: NounPhrase,
    condition: Condition,
    reader: TokenReader,
    meaning: ClauseMeaning,
) -> None:
    """Add the effect of a condition on "visit x"."""
    kind, when = condition.kind, condition.targets
    # "Whenever you visit y, visit x" and "once you visit y you must visit x": x after every y.
    answers = (condition.recurring and clause.mood != "can") or clause.mood == "must"
    if kind == "after" and clause.verb.startswith(_END_VERBS) and not condition.recurring:
        answers = False  # the end of the mission is no reaction
    _refuse_count_in_condition(condition, reader)
    if clause.next_step and kind in ("before", "until"):
        reader.refuse("'right before' is not possible", condition.token)
    if clause.next_step and not answers:
        reader.refuse_finally("say 'whenever …, you must … right after that'", condition.token)
    if kind == "when" and condition.denied:
        hint = "a condition that something never happens is not possible"
        reader.refuse_finally(hint, condition.token)
    if set(when.names) & set(targets.names) and not answers:
        reader.refuse_finally("nothing comes before or after itself", condition.token)
    if kind == "before" and condition.only and not condition.denied:
        reader.refuse_finally("say 'before …', or 'never after …'", condition.token)
    if kind == "until" and clause.through and not condition.denied and not condition.only:
        meaning.goals = [steps([*meaning.goals, visits(when)])]
        meaning.targets = when  # "go through the hallway until you reach the bed"
        return
    if kind == "until" and not condition.denied:
        hint = "'until' is not possible for a visit; say what comes after what"
        reader.refuse(hint, condition.token)
    if condition.denied and kind != "after":  # "visit x, but not before y"
        meaning.rules += held_until(targets.names, when)
    elif kind == "unless":
        reader.refuse("'unless' is possible only with something forbidden", condition.token)
    elif kind == "before" and (clause.mood != "can" or condition.only):
        way = "in order"  # "visit x, but visit y before that": y, then x
        if not condition.referred or clause.mood == "can":
            is_rule = _is_rule(clause, condition, reader)
            pick = reader.pick(condition.token, len(_BEFORE_READINGS)) if is_rule else 0
            way = _BEFORE_READINGS[pick]
        if way != "in order":
            meaning.rules += held_until(when.names, targets)
        if way != "first only":
            meaning.goals = [steps([*meaning.goals, visits(when)])]
            meaning.targets = when
    elif condition.only:
        meaning.rules += held_until(targets.names, when)
        meaning.waits.append((targets.names, when))
    elif condition.denied:
        reader.refuse("say 'do not …, once …'", condition.token)
    elif answers:
        _add_reaction(clause, targets, condition, reader, meaning)
    elif clause.mood != "can":
        meaning.anchors.append(when)


def _is_rule(clause: Clause, condition: Condition, reader: TokenReader) -> bool:
    """Return True if "x before y" may leave open if y is to be reached at all.

    "Make sure that …", "x must be visited …" and "… before you may ever go to y" do. A plain order
    does not, unless it is an alternative, an avoidance, or one of several in a sequence.
    """
    duty = clause.mood == "must" and not clause.subject
    if duty or clause.done or clause.token.text.startswith(_DUTY_STARTS):
        return True
    # Positions of the clause's and of the condition's first token.
    start, begin = (
        next(i for i, token in enumerate(reader.tokens) if token is wanted)
        for wanted in (clause.token, condition.token)
    )
    kinds = [token.kind for token in reader.tokens]
    if "or" in kinds[max(start - 1, 0) : start + 1] or "while" in kinds[:begin]:
        return True
    if kinds.count("before") > 1 and "then" in kinds:
        return True
    rest = itertools.takewhile(lambda t: t.kind not in ("stop", "comma"), reader.tokens[begin:])
    return any(token.kind == "can" or token.text == "ever" for token in rest)


def _add_reaction(
    clause: Clause,
    targets: NounPhrase,
    condition: Condition,
    reader: TokenReader,
    meaning: ClauseMeaning,
) -> None:
    """Add `once you visit x you must visit y`: G(x -> F y), or X y for "right after"."""
    if len(condition.targets.groups) != 1:
        reader.refuse("a condition can have one object, or a choice of objects", condition.token)
    when = any_reached(condition.targets.groups[0])
    if clause.next_step or clause.soon:
        if len(targets.groups) != 1:
            reader.refuse("only one object can be reached in the next step", clause.token)
        answer = next_(any_reached(targets.groups[0]))
    else:
        goals = meaning.goals or [visits(targets)]
        answer = formula_of(AllOf(tuple(goals)))
        if set(condition.targets.names) & set(targets.names):
            answer = next_(answer)
    meaning.goals = []
    meaning.targets = NounPhrase(())
    meaning.rules.append(always(implies(when, answer)))
