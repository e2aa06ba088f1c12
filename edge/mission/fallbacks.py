"""Formulas of orders with a condition: "find the mug; if it is not there, come back".

The failure of a target is a proposition, "no mug" for "mug" (see `FailureTarget`), so such an order
is an alternative: `F mug | F ("no mug" & F here)`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Union

from edge import names
from edge.memory import parse_description
from edge.mission.language.errand_patterns import CHECK, WAIT
from edge.mission.language.everyday_words import bare, is_room
from edge.mission.language.fallbacks import Branches, OutcomeCondition, areas_of, sought_in
from edge.mission.language.nouns import is_plural
from edge.mission.language.places import EXPLORED, NO
from edge.mission.language.tokens import UnclearError
from edge.mission.logic.ltl import (
    Formula,
    ap,
    conj,
    disj,
    eventually,
    next_,
    postorder,
    propositions,
)
from edge.text import one_line

# Orders that ask for nothing more: the robot is there, stops anyway, or reports anyway.
_NOTHING_MORE = re.compile(
    r"^(?:(?:(?:go|drive|head|move|come|walk|roll)(?: right| straight| over| up)* "
    r"(?:to|next to|near|towards) (?:it|them|one|him|her)|go there|"
    r"stop(?: there| here| next to it)?|give up|forget (?:it|about it)|never mind|do nothing|do not bother|that is it|"
    r"(?:tell|inform|notify) (?:me|us)|let (?:me|us) know|report(?: back)?(?: to me)?)"
    r"(?: that| so| about it| (?:where|if) (?:it|they) (?:is|are))?(?=[,.;!?]|$| and | then ))"
    r"(?:[\s,.;!?]+(?:(?:and|then) )*)?",
    re.I,
)
_FIND_IT = re.compile(
    r"^(?P<find>(?:go and |go )?(?:find|look for|search for|locate|hunt for)) (?:it|them|one)\b",
    re.I,
)
_THERE = re.compile(r"\b(?:there|here)\b", re.I)
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
    after: Formula | None = None


_Tree = Union[_Leaf, _Node]
_NONE = _Leaf(None)


@dataclass(frozen=True, slots=True)
class FallbackTranslator:
    """Translator of orders with conditions.

    Attributes:
        translate: returns the formula of an order without conditions.
        is_thing: returns True if a proposition is a thing to search for.
    """

    translate: Callable[[str], Formula]
    is_thing: Callable[[str], bool]

    def readings(self, branches: Branches) -> list[Formula]:
        """Return the formulas that the branches may mean, one or two.

        In "if it is not there, go to the hall, then come back", the end may belong to the condition
        or not.

        Raises:
            UnclearError: it is unclear what a condition is about.
        """
        tree = self._tree(branches, "")
        rest = _last_leaf(tree).rest
        if rest is None:
            return [_formula(tree, None, False)]
        return [_formula(tree, rest, True), _formula(tree, None, False)]

    def _tree(self, part: Branches | str | None, noun: str, found: bool = False) -> _Tree:
        """Return a part of the order with formulas; `noun` is what it searches for, or ""."""
        if isinstance(part, Branches):
            return self._node(part, noun)
        return self._leaf(part or "", noun, found)

    def _leaf(self, text: str, noun: str, found: bool) -> _Tree:
        text = _NOTHING_MORE.sub("", text)
        orders, rest = areas_of(text, noun) if noun and not found else ([], "")
        if orders:
            later = self.translate(rest) if rest else None
            tree: _Tree = _Leaf(self.translate(orders[-1]), later)
            for order in reversed(orders[:-1]):
                tree = _Node(self.translate(order), _NONE, tree)
            return tree
        if noun and not found:
            text = _FIND_IT.sub(rf"\g<find> {noun}", text)
            text = f"go to {text}" if is_room(bare(text)) else text
        elif is_room(bare(text)):
            text = f"go to {text}"
        if not text:
            return _NONE
        formula = self.translate(text)
        if any(part.op in ("G", "W") for part in postorder(formula)):
            hint = "unclear if this always holds or only then; say first what to avoid"
            raise UnclearError(f"instruction: {one_line(text)!r}: {hint}", text)
        first, later = _split_first(formula)
        waits = later is not None and all(n.startswith(WAIT) for n in propositions(later))
        return _Leaf(formula) if waits or _THERE.search(text) else _Leaf(first, later)

    def _node(self, branches: Branches, noun: str) -> _Node:
        condition = branches.condition
        order, asks = self._order(branches, noun)
        goal = _last_goal(order)
        if goal.startswith(f"{CHECK} "):
            asks = True
            order = _with_last(order, lambda _: eventually(ap(goal.removeprefix(f"{CHECK} "))))
            goal = _last_goal(order)
        if condition.thing and branches.order and not _is_same(goal, condition.thing):
            thing = _singular(condition.thing)
            order = _then(order, self.translate(f"find {thing}{_place(condition, goal)}"))
            asks = True
        elif condition.at.endswith(" it"):
            raise UnclearError(f"instruction: {condition.at.strip()!r}: unclear what 'it' is")
        elif condition.at and branches.order:
            order = self._at(order, goal, condition)
        goal = _last_goal(order)
        self._check_kind(goal, condition)
        noun = _noun(goal) if self.is_thing(goal) else ""
        node = _Node(
            order,
            self._tree(branches.found, noun, found=True),
            self._tree(branches.failed, noun),
            asks or condition.outcome == "failed" or branches.explicit,
            self.translate(branches.after) if branches.after else None,
        )
        if branches.explicit:
            return _without_question(node, branches)
        return node

    def _order(self, branches: Branches, noun: str) -> tuple[Formula, bool]:
        """Return the formula of the order, and True if it only asks if a thing is there."""
        condition = branches.condition
        if branches.order:
            orders, rest = areas_of(branches.order, noun) if noun else ([], "")
            if len(orders) == 1 and not rest:
                return self.translate(orders[0]), True
            text = _FIND_IT.sub(rf"\g<find> {noun}", branches.order) if noun else branches.order
            return self.translate(text), False
        thing = condition.thing
        if not thing and condition.at and isinstance(branches.failed, str):
            thing = sought_in(branches.failed)  # "look for it on the desk if it is not in the hall"
        if not thing or not (condition.presumes or branches.explicit or condition.at):
            hint = "say first what to do, as in 'find the mug; if it is not there, come back'"
            raise UnclearError(f"instruction: unclear what the condition is about; {hint}")
        thing, verb = _singular(thing), "go to" if condition.seeks is False else "find"
        return self.translate(f"{verb} {thing}{condition.at}"), True

    def _at(self, order: Formula, goal: str, condition: OutcomeCondition) -> Formula:
        """Return the order with the place that the condition names: "if it is not in the hall"."""
        placed = self.translate(f"find the {goal}{condition.at}")
        if parse_description(goal) is not None and propositions(placed) != (goal,):
            if goal.endswith(condition.at.lower()):
                return order
            raise UnclearError(f"instruction: unclear where the {one_line(goal)} should be")
        return _with_last(order, lambda _: placed)

    def _check_kind(self, goal: str, condition: OutcomeCondition) -> None:
        """Refuse a condition that does not fit the goal: a wait is not found."""
        thing = self.is_thing(goal)
        timed = goal.startswith(("wait", EXPLORED))
        described = parse_description(goal)
        if described is not None and described.is_new:
            hint = "say what to do for one of them; a number of things cannot have a fallback"
            raise UnclearError(f"instruction: {one_line(goal)!r}: {hint}")
        if timed or (condition.seeks and not thing) or (condition.state and thing):
            part = condition.thing or "it"
            hint = "unclear what this is about, or a state that the robot cannot see"
            raise UnclearError(f"instruction: {part!r}: {hint}", part)


def _without_question(node: _Node, branches: Branches) -> _Node:
    """Join the goals of the last leaf, unless "then" may begin an end for both outcomes."""
    last_is_found = branches.condition.outcome == "failed"
    text = branches.found if last_is_found else branches.failed
    leaf = node.found if last_is_found else node.failed
    if not isinstance(text, str) or not isinstance(leaf, _Leaf) or leaf.rest is None:
        return node
    if _THEN.search(text):
        return node
    assert leaf.first is not None
    joined = _Leaf(_then(leaf.first, leaf.rest))
    if last_is_found:
        return _Node(node.order, joined, node.failed, node.may_fail, node.after)
    return _Node(node.order, node.found, joined, node.may_fail, node.after)


def _last_leaf(tree: _Tree) -> _Leaf:
    """Return the leaf whose last goals may come after all: that of the one outcome with orders."""
    while isinstance(tree, _Node):
        if tree.after is not None:
            return _NONE
        with_rest = [one for one in (tree.failed, tree.found) if _has_rest(one)]
        if not with_rest:
            return _NONE
        tree = with_rest[0]
    return tree


def _has_rest(tree: _Tree) -> bool:
    if isinstance(tree, _Leaf):
        return tree.rest is not None
    return _has_rest(tree.found) or _has_rest(tree.failed)


def _formula(tree: _Tree, after: Formula | None, spread: bool) -> Formula | None:
    """Return the formula of a tree; None if it asks for nothing.

    Args:
        tree: the tree.
        after: what comes after each outcome.
        spread: True if `after` has the rest of the last leaf.
    """
    if isinstance(tree, _Leaf):
        parts = (tree.first, None if spread else tree.rest, after)
        return _in_sequence(*parts)
    after = _in_sequence(tree.after, after)
    found, failed = _formula(tree.found, after, spread), _formula(tree.failed, after, spread)

    def branch(goal: Formula) -> Formula:
        names_of_goal = propositions(goal)
        missed = failed
        for name in reversed(names_of_goal):
            missed = _reach(ap(NO + name), missed)
        assert missed is not None
        reached = _reach(goal, found)
        # "have you seen the mug? If not, look for it"
        return disj(reached, missed) if tree.may_fail and failed != reached else reached

    return _with_last(tree.order, branch)


def _in_sequence(*parts: Formula | None) -> Formula | None:
    given = [part for part in parts if part is not None]
    if not given:
        return None
    formula = given[-1]
    for part in reversed(given[:-1]):
        formula = _then(part, formula)
    return formula


def _reach(goal: Formula, after: Formula | None) -> Formula:
    if after is None:
        return eventually(goal)
    again = set(propositions(goal)) & set(propositions(after))  # one visit could be both
    return eventually(conj(goal, next_(after) if again else after))


def _then(first: Formula, after: Formula) -> Formula:
    return _with_last(first, lambda goal: _reach(goal, after))


def _with_last(formula: Formula, change: Callable[[Formula], Formula]) -> Formula:
    """Return a sequence with its last goal replaced: `change` gets a proposition, or a choice."""
    if formula.op == "|" and all(one.op == "F" and one.args[0].op == "ap" for one in formula.args):
        return change(disj(*(one.args[0] for one in formula.args)))
    if formula.op == "&":
        bans = [one for one in formula.args if one.op == "G"]
        goals = [one for one in formula.args if one.op != "G"]
        if len(goals) == 1:
            return conj(_with_last(goals[0], change), *bans)
    if formula.op == "F":
        body = formula.args[0]
        if _is_goal(body):
            return change(body)
        if body.op == "&" and len(body.args) == 2 and _is_goal(body.args[0]):
            goal, later = body.args
            strict = later.op == "X"
            later = _with_last(later.args[0] if strict else later, change)
            return eventually(conj(goal, next_(later) if strict else later))
    hint = "unclear what the condition is about; use one sequence of orders before it"
    raise UnclearError(f"instruction: {hint}")


def _is_goal(formula: Formula) -> bool:
    parts = formula.args if formula.op == "|" else (formula,)
    return all(part.op == "ap" for part in parts)


def _last_goal(order: Formula) -> str:
    """Return the name of the last goal; the first of a choice."""
    found: list[Formula] = []

    def note(goal: Formula) -> Formula:
        found.append(goal)
        return eventually(goal)

    _with_last(order, note)
    return propositions(found[0])[0]


def _split_first(formula: Formula) -> tuple[Formula, Formula | None]:
    """Return the first goal of a sequence and the rest; the formula and None for others."""
    body = formula.args[0] if formula.op == "F" else formula
    if formula.op == "F" and body.op == "&" and len(body.args) == 2 and _is_goal(body.args[0]):
        goal, later = body.args
        return eventually(goal), later.args[0] if later.op == "X" else later
    return formula, None


def _noun(goal: str) -> str:
    thing = parse_description(goal)
    return f"the {goal if thing is None else thing.noun}"


def _singular(thing: str) -> str:
    """Return the name of one of several: "chair" of "if there are no chairs"."""
    before, space, last = thing.rpartition(" ")
    return f"{before}{space}{names.singular(last)}" if is_plural(last) else thing


def _is_same(goal: str, thing: str) -> bool:
    known = parse_description(goal)
    nouns = {goal, goal if known is None else known.noun}
    return names.canonical(bare(_singular(thing))) in {names.canonical(one) for one in nouns}


def _place(condition: OutcomeCondition, goal: str) -> str:
    """Return the place of a thing that the condition names: the last room for "there"."""
    if condition.at.endswith(" it"):  # "if there is a cat on it"
        return f"{condition.at[:-2]}{_noun(goal)}"
    if condition.at:
        return condition.at
    room = goal.removeprefix(f"{EXPLORED} ").partition(" for ")[0]
    if not condition.there or not is_room(room) or condition.seeks is False:
        part = condition.thing
        hint = "say where, as in 'if there is a cup in the kitchen'"
        raise UnclearError(f"instruction: {part!r}: {hint}", part)
    return f" in the {room}"
