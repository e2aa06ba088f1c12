"""Formulas of orders with a condition: "find the mug; if it is not there, come back".

The failure of a target is a proposition, "no mug" for "mug" (see `FailureTarget`), so such an order
is an alternative: `F mug | F ("no mug" & F here)`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Union

from edge import names
from edge.memory import parse_description
from edge.mission.language.errands.areas import areas_of, searched_object
from edge.mission.language.errands.errand_patterns import CHECK, WAIT
from edge.mission.language.errands.outcomes import Branches, OutcomeCondition
from edge.mission.language.words.everyday_words import NAME, bare, is_room
from edge.mission.language.words.nouns import is_plural
from edge.mission.language.words.places import EXPLORED, NO
from edge.mission.language.words.tokens import UnclearError, unclear
from edge.mission.logic import goal_sequence
from edge.mission.logic.goal_sequence import last_goals, reach, replace_last, then
from edge.mission.logic.ltl import Formula, ap, conj, disj, eventually, propositions

# Orders that ask for nothing more: the robot stops anyway, or reports anyway.
_NOTHING_MORE = (
    r"stop(?: there| here| next to it)?|give up|forget (?:it|about it)|never mind|do nothing|"
    r"do not bother|that is it|"
    r"(?:tell|inform|notify) (?:me|us)|let (?:me|us) know|report(?: back)?(?: to me)?)"
    r"(?: that| so| about it| (?:where|if) (?:it|they) (?:is|are))?(?=[,.;!?]|$| and | then ))"
    r"(?:[\s,.;!?]+(?:(?:and|then) )*)?"
)
_STOPS = re.compile(f"^(?:(?:{_NOTHING_MORE}", re.I)
# The same after a success: the robot is there already.
_DONE = re.compile(
    r"^(?:(?:(?:go|drive|head|move|come|walk|roll)(?: right| straight| over| up)* "
    rf"(?:to|next to|near|towards) (?:it|them|one|him|her)|go there|{_NOTHING_MORE}",
    re.I,
)
_GO_THERE = re.compile(
    r"^(?:(?:go|drive|head) there(?:,? (?:and then|and|then))?(?=[\s,.;!?]|$)[\s,.;!?]*"
    r"|(?=(?:wait|stay) there\b))",
    re.I,
)
_WAIT_THERE = re.compile(r"^(wait|stay) there\b", re.I)
_FIND_IT = re.compile(
    r"^(?P<find>(?:go and |go )?(?:find|look for|search for|locate|hunt for)) (?:it|them|one)\b",
    re.I,
)
# "go to the mug", "find it" after "if it is there"
_GO_NAMED = re.compile(
    r"^(?:(?:go|drive|head|move|come|walk|roll)(?: right| straight| over| up)* "
    r"(?:to|next to|near|towards)|visit|reach|approach|find|look for|search for|locate) "
    rf"(?P<name>it|them|one|{NAME})(?=[,.;!?]|$| (?:and|then) )",
    re.I,
)
_HERE = re.compile(r"\b(?:there|here)\b", re.I)
_WAIT_HERE = re.compile(r"\b(?:wait|stay|remain)(?: right)? here\b", re.I)
_NEXT_SENTENCE = re.compile(r"[.;!?] ")
_BY_WAY = re.compile(r"\b(?:through|via|past|by way of)\b", re.I)
_WHEN = re.compile(r"\b(?:when|whenever|once|as soon as|after|until|before|while|unless)\b", re.I)
# "it must be in the hall"
_STATES = re.compile(r"(?:it|they|he|she|that|this|i|we|you) ", re.I)
_IS_THERE = re.compile(r"\bthere\b(?! (?:is|are|an?|the|any|some|my|still)\b)", re.I)
_UNPLACED = "unclear which place or order the condition is about; use simpler sentences"
# "look on it", "find it", but not "look for the cup"
_LOOKS = re.compile(
    r"\b(?:look|search|hunt|check|try)\b(?! (?:for (?!it\b|them\b|one\b)|if\b|whether\b))|"
    r"\b(?:find|locate) (?:it|them|one)\b",
    re.I,
)
_DRIVES = re.compile(r"(?:go|drive|head|move|run|roll|come|visit|reach)\b", re.I)
_NEAREST = re.compile(r"\b(?:nearest|closest)\b", re.I)
_THEN = re.compile(r"[,.;!?] (?:and )?then\b", re.I)


@dataclass(frozen=True, slots=True)
class _Leaf:
    """Orders without a condition: the first goal, and the others that come after it, if any."""

    first: Formula | None
    rest: Formula | None = None


@dataclass(frozen=True, slots=True)
class _Node:
    """An order whose last goal may fail, and what comes after each outcome.

    Attributes:
        may_fail: True if the mission goes on after the failure.
    """

    order: Formula
    found: _Tree
    failed: _Tree
    may_fail: bool = True


_Tree = Union[_Leaf, _Node]
_NONE = _Leaf(None)


@dataclass(frozen=True, slots=True)
class FallbackTranslator:
    """Translator of orders with conditions.

    Attributes:
        translate: returns the formula of an order without conditions.
        is_object: returns True if a proposition is an object to search for.
    """

    translate: Callable[[str], Formula]
    is_object: Callable[[str], bool]

    def readings(self, branches: Branches) -> list[Formula]:
        """Return the formulas that the branches may mean, one or two.

        In "if it is not there, go to the hall, then come back", the end may belong to the condition
        or not.

        Raises:
            UnclearError: it is unclear what a condition is about.
        """
        after, bans = self._end(branches.after)
        try:
            tree = self._node(branches, "", True)
            rest = None if after else _rest_of(tree)
            last = _formula(tree, after, False)
            found = [formula for formula in (rest and _formula(tree, rest, True), last) if formula]
        except goal_sequence.NotASequenceError:
            hint = "unclear what the condition is about; use one sequence of orders before it"
            raise UnclearError(f"instruction: {hint}") from None
        return [conj(formula, *bans) for formula in found]

    def _end(self, text: str) -> tuple[Formula | None, list[Formula]]:
        """Return the goals and the bans of the orders that hold in any case."""
        if not text:
            return None, []
        goals, bans = goal_sequence.split_bans(self.translate(text))
        if not goals:
            return None, bans
        _refuse_rules(conj(*goals), text)
        return conj(*goals), bans

    def _after_success(self, part: Branches | str, noun: str, last: bool) -> _Tree:
        """Return what comes after an order, with formulas.

        Args:
            part: what comes after it.
            noun: the object that was found, or "".
            last: True if the end of the part may belong to all outcomes.
        """
        if isinstance(part, Branches):
            return self._nested(part, noun, last)
        named = _GO_NAMED.match(part)
        nouns = ["it", "them", "one", noun.removeprefix("the ")]
        if noun and named is not None and _is_same(nouns, named["name"]):
            part = f"go to it{part[named.end() :]}"
        text = _FIND_IT.sub(rf"\g<find> {noun}" if noun else r"\g<0>", _DONE.sub("", part))
        return self._leaf(text, last)

    def _after_failure(self, part: Branches | str, noun: str, last: bool, place: str) -> _Tree:
        """Return what comes after an order that failed, with formulas.

        Args:
            part: see `_after_success`.
            noun: the object that was not found, or "".
            last: see `_after_success`.
            place: the room in which it was searched for, or "".
        """
        if isinstance(part, Branches):
            return self._nested(part, noun, last)
        if found := _WAIT_HERE.search(part):
            hint = "say 'come back here, then wait', or 'wait there'"
            raise unclear(found[0], f"unclear where; {hint}")
        text = _STOPS.sub("", part)
        orders, text = areas_of(text, noun) if noun else ([], text)
        text = _FIND_IT.sub(rf"\g<find> {noun}" if noun and not orders else r"\g<0>", text)
        if noun and (found := _LOOKS.search(text)):
            hint = "say 'look on the …' or 'look in the …', with one name each"
            raise UnclearError(f"instruction: {text!r}: unclear where to look; {hint}", found[0])
        there = _GO_THERE.match(text)
        if there is not None:
            text = _WAIT_THERE.sub(r"\1", text[there.end() :])
        if (there and not place) or _IS_THERE.search(text):
            raise UnclearError("instruction: 'there': unclear where; name the room", "there")
        if there:
            leaf, goal = self._leaf(text, last), self.translate(f"go to the {place}")
            return _Leaf(then(goal, leaf.first), leaf.rest)
        if not orders:
            return self._leaf(text, last)
        *before, order = map(self.translate, orders)
        tree: _Tree = _leaf(order, self._goals(text) if text else None, last)
        for order in reversed(before):
            tree = _Node(order, _NONE, tree)
        return tree

    def _nested(self, branches: Branches, noun: str, last: bool) -> _Node:
        node = self._node(branches, noun, last)
        _refuse_rules(node.order, branches.order)
        return node

    def _leaf(self, text: str, last: bool) -> _Leaf:
        if not text:
            return _NONE
        named = re.fullmatch(NAME, text, re.I) and is_room(bare(text))  # "otherwise the hall"
        formula = self._goals(f"go to {text}" if named else text)
        first, later = goal_sequence.split_first(formula, bool(_NEXT_SENTENCE.search(text)))
        waits = later is not None and all(n.startswith(WAIT) for n in propositions(later))
        return _leaf(first, later, last and not (waits or _HERE.search(text)))

    def _goals(self, text: str) -> Formula:
        """Return the formula of orders after a condition: only goals."""
        if _STATES.match(text):
            hint = "after a condition, expected an order; say for example 'look in the hall'"
            raise unclear(text, hint)
        formula = self.translate(text)
        _refuse_rules(formula, text)
        return formula

    def _node(self, branches: Branches, noun: str, last: bool) -> _Node:
        condition, found, failed = branches.condition, branches.found or "", branches.failed or ""
        order, asks = self._order(branches, noun)
        goals = last_goals(order)
        if all(goal.startswith(f"{CHECK} ") for goal in goals):
            if _IS_THERE.search(branches.order) and not all(map(parse_description, goals)):
                raise UnclearError(f"instruction: {_UNPLACED}")
            asks, goals = True, tuple(goal.removeprefix(f"{CHECK} ") for goal in goals)
            order = replace_last(order, lambda _: eventually(disj(*map(ap, goals))))
        self._check_subject(branches, order, goals, noun)
        if condition.name and branches.order and not _is_same(goals, condition.name):
            name = _singular(condition.name)
            search = self.translate(f"find {name}{_place(condition, goals)}")
            order = replace_last(order, lambda goal: reach(goal, search))
            asks = True
        elif condition.at and branches.order:
            if _DRIVES.match(branches.order) or _NEAREST.search(branches.order):
                raise UnclearError(f"instruction: {_UNPLACED}")
            order = self._at(order, goals, condition)
        goals = last_goals(order)
        self._check_kind(goals, condition)
        noun = _noun(goals[0]) if all(map(self.is_object, goals)) else ""
        described = parse_description(goals[0]) if noun else None
        place = described.room if described is not None else ""
        end = failed if branches.both == (condition.outcome == "found") else found
        if branches.both and isinstance(end, str):  # "…, otherwise go to the hall, then …"
            last = last and _THEN.search(end) is not None
        return _Node(
            order,
            self._after_success(found, noun, last and end is found),
            self._after_failure(failed, noun, last and end is failed, place),
            asks or condition.outcome == "failed" or branches.both,
        )

    def _order(self, branches: Branches, noun: str) -> tuple[Formula, bool]:
        """Return the formula of the order, and True if it only asks if an object is there."""
        condition = branches.condition
        if branches.order:
            by_way = condition.state and not condition.name and _BY_WAY.search(branches.order)
            if by_way or _WHEN.search(branches.order):
                raise UnclearError(f"instruction: {_UNPLACED}")
            orders, rest = areas_of(branches.order, noun) if noun else ([], "")
            if len(orders) == 1 and not rest:
                return self.translate(orders[0]), True
            text = _FIND_IT.sub(rf"\g<find> {noun}", branches.order) if noun else branches.order
            return self.translate(text), False
        name = condition.name
        answer = branches.failed if condition.outcome == "failed" else branches.found
        if not name and condition.at and isinstance(answer, str):
            # "look for the mug in the hall if it is not on the desk"
            name = searched_object(answer)
        presumes = condition.presumes or branches.both or condition.at
        if not (name and presumes) or (condition.there and not condition.at):
            hint = "say first what to do, as in 'find the mug; if it is not there, come back'"
            raise UnclearError(f"instruction: unclear what the condition is about; {hint}")
        name, verb = _singular(name), "go to" if condition.is_object is False else "find"
        return self.translate(f"{verb} {name}{condition.at}"), True

    def _check_subject(
        self, branches: Branches, order: Formula, goals: Sequence[str], noun: str
    ) -> None:
        """Refuse a condition that may be about something else than the last goal of its order.

        "Find the mug, then go to the bed, and if you can't find it …" may be about the mug.
        """
        condition, others = branches.condition, set(_targets(order)).difference(goals)
        if any((described := parse_description(goal)) and described.is_new for goal in goals):
            hint = "a number of objects cannot have a fallback; say it for one of them"
            raise UnclearError(f"instruction: {hint}")
        are_objects = all(map(self.is_object, goals))
        if condition.name:  # one of a choice
            is_unclear = len(goals) > 1 and _is_same(goals, condition.name)
        elif not branches.order:
            is_unclear = False
        elif are_objects and condition.is_object is not False:
            new = condition.is_object and noun and _noun(goals[0]) != noun
            drives = new and _DRIVES.match(branches.order) is not None
            is_unclear = bool(drives or any(map(self.is_object, others)))
        else:
            rooms = [found.room for found in map(parse_description, goals) if found is not None]
            is_unclear = bool(others or (condition.is_object and noun) or any(rooms))
        if is_unclear:
            part = condition.name or "it"
            hint = "unclear which of the orders the condition is about; use one order before it"
            raise unclear(part, hint)

    def _at(self, order: Formula, goals: Sequence[str], condition: OutcomeCondition) -> Formula:
        """Return the order with the place that the condition names: "if it is not in the hall"."""
        if len(goals) == 1 and goals[0].endswith(condition.at.lower()):
            return order
        if condition.outcome == "found":  # "find the dog; if it is in the kitchen, come back"
            raise UnclearError(f"instruction: {_UNPLACED}")
        if len(goals) > 1 or parse_description(goals[0]) or condition.at.endswith(" it"):
            part = condition.at.strip()
            raise unclear(part, "unclear what should be there")
        return replace_last(order, lambda _: self.translate(f"find the {goals[0]}{condition.at}"))

    def _check_kind(self, goals: Sequence[str], condition: OutcomeCondition) -> None:
        """Refuse a condition that does not fit the goals: a wait is not found."""
        are_objects, part = all(map(self.is_object, goals)), condition.name or "it"
        timed = goals[0].startswith((WAIT, EXPLORED))
        is_there = condition.is_object and condition.there and not are_objects
        if condition.state and are_objects:
            raise unclear(part, "the robot cannot see this state; say it for a room or a place")
        if timed or is_there:
            raise unclear(part, "unclear what this is about; name the object that may be missing")


def _refuse_rules(formula: Formula, text: str) -> None:
    if not goal_sequence.has_only_goals(formula):
        hint = "with a condition, only goals are understood here; say first what to avoid"
        raise unclear(text, hint)


def _targets(formula: Formula) -> tuple[str, ...]:
    """Return the propositions of a formula without its bans."""
    return propositions(conj(*goal_sequence.split_bans(formula)[0]))


def _leaf(first: Formula, rest: Formula | None, last: bool) -> _Leaf:
    return _Leaf(first, rest) if last or rest is None else _Leaf(then(first, rest))


def _rest_of(tree: _Tree) -> Formula | None:
    """Return the end that may belong to all outcomes."""
    if isinstance(tree, _Leaf):
        return tree.rest
    return _rest_of(tree.found) or _rest_of(tree.failed)


def _formula(tree: _Tree, after: Formula | None, spread: bool) -> Formula | None:
    """Return the formula of a tree; None if it asks for nothing.

    Args:
        tree: the tree.
        after: what comes after each outcome.
        spread: True if `after` has the rest of the last leaf.
    """
    if isinstance(tree, _Leaf):
        return then(tree.first, None if spread else tree.rest, after)
    found, failed = _formula(tree.found, after, spread), _formula(tree.failed, after, spread)

    def branch(goal: Formula) -> Formula:
        names_of_goal = propositions(goal)
        missed = failed
        for name in reversed(names_of_goal):
            missed = reach(ap(NO + name), missed)
        assert missed is not None
        reached = reach(goal, found)
        # "have you seen the mug? If not, look for it"
        return disj(reached, missed) if tree.may_fail and failed != reached else reached

    return replace_last(tree.order, branch)


def _noun(goal: str) -> str:
    described = parse_description(goal)
    return f"the {goal if described is None else described.noun}"


def _singular(name: str) -> str:
    """Return the name of one of several: "chair" of "if there are no chairs"."""
    before, space, last = name.rpartition(" ")
    return f"{before}{space}{names.singular(last)}" if is_plural(last) else name


def _is_same(goals: Sequence[str], name: str) -> bool:
    nouns = {*goals, *(_noun(goal).removeprefix("the ") for goal in goals)}
    return names.canonical(bare(_singular(name))) in {names.canonical(one) for one in nouns}


def _place(condition: OutcomeCondition, goals: Sequence[str]) -> str:
    """Return the place of an object that the condition names: the last room for "there"."""
    goal = goals[0]
    if len(goals) > 1 and (not condition.at or condition.at.endswith(" it")):
        raise UnclearError(f"instruction: {condition.name!r}: unclear where; name the place")
    if condition.at.endswith(" it"):  # "if there is a cat on it"
        return f"{condition.at[:-2]}{_noun(goal)}"
    if condition.at:
        return condition.at
    room = goal.removeprefix(f"{EXPLORED} ").partition(" for ")[0]
    if not condition.there or not is_room(room) or condition.is_object is False:
        part = condition.name
        raise unclear(part, "say where, as in 'if there is a cup in the kitchen'")
    return f" in the {room}"
