"""Sequences of goals: formulas such as `F (a & F b)`, with bans such as `G !c` next to them.

A goal is a proposition or a choice of propositions. In a sequence it is reached, then the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from edge.mission.logic.ltl import Formula, conj, disj, eventually, next_, postorder, propositions


class NotASequenceError(ValueError):
    """A formula that is no sequence of goals."""


def split_bans(formula: Formula) -> tuple[list[Formula], list[Formula]]:
    """Return the goals and the bans that a formula joins by `&`."""
    parts = formula.args if formula.op == "&" else (formula,)
    return [p for p in parts if p.op != "G"], [p for p in parts if p.op == "G"]


def has_only_goals(formula: Formula) -> bool:
    """Return True without rules: no part always holds, is denied, or waits for another."""
    return not any(part.op in ("G", "W", "U", "!") for part in postorder(formula))


def reach(goal: Formula, after: Formula | None) -> Formula:
    """Return "the goal is reached, then `after` holds"; None: nothing comes after it."""
    if after is None:
        return eventually(goal)
    again = set(propositions(goal)) & set(propositions(after))  # one visit could be both
    return eventually(conj(goal, next_(after) if again else after))


def then(*parts: Formula | None) -> Formula | None:
    """Return the parts in sequence, without those that are None; None if all are."""
    given = [part for part in parts if part is not None]
    if not given:
        return None
    *before, formula = given
    for part in reversed(before):
        formula = replace_last(part, partial(reach, after=formula))
    return formula


def replace_last(formula: Formula, change: Callable[[Formula], Formula]) -> Formula:
    """Return a sequence with its last goal replaced by the result of `change`.

    Raises:
        NotASequenceError: the formula has no last goal.
    """
    if formula.op == "|" and all(one.op == "F" and one.args[0].op == "ap" for one in formula.args):
        return change(disj(*(one.args[0] for one in formula.args)))
    if formula.op == "&":
        goals, bans = split_bans(formula)
        if len(goals) == 1:
            return conj(replace_last(goals[0], change), *bans)
    if formula.op == "F":
        body = formula.args[0]
        if _is_goal(body):
            return change(body)
        if body.op == "&" and len(body.args) == 2 and _is_goal(body.args[0]):
            goal, later = body.args
            strict = later.op == "X"
            later = replace_last(later.args[0] if strict else later, change)
            return eventually(conj(goal, next_(later) if strict else later))
    raise NotASequenceError(str(formula))


def last_goals(formula: Formula) -> tuple[str, ...]:
    """Return the name of the last goal, or each name of a choice.

    Raises:
        NotASequenceError: the formula has no last goal.
    """
    found: list[Formula] = []

    def note(goal: Formula) -> Formula:
        found.append(goal)
        return goal

    replace_last(formula, note)
    return propositions(found[0])


def split_first(formula: Formula, several: bool) -> tuple[Formula, Formula | None]:
    """Return the first goal of a sequence and the rest; the formula and None for others.

    Args:
        formula: the sequence.
        several: True if goals in any order come from several sentences: the first one counts.
    """
    if formula.op == "&" and several:
        return formula.args[0], conj(*formula.args[1:])
    body = formula.args[0] if formula.op == "F" else formula
    if formula.op == "F" and body.op == "&" and len(body.args) == 2 and _is_goal(body.args[0]):
        goal, later = body.args
        return eventually(goal), later.args[0] if later.op == "X" else later
    return formula, None


def _is_goal(formula: Formula) -> bool:
    parts = formula.args if formula.op == "|" else (formula,)
    return all(part.op == "ap" for part in parts)
