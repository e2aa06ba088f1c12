"""Description of a mission as orders, such as "Go to the kitchen, then wait.".

The person who gave the instruction sees it. `edge.mission.language.grammar.english`
describes any formula by what is reached; this module describes the common forms as a person would
say them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from edge.memory import parse_description
from edge.mission.destinations import (
    CALLER,
    CheckTarget,
    Destination,
    EveryObjectTarget,
    EveryRoomTarget,
    ExploreTarget,
    FailureTarget,
    RoomTarget,
    WaitTarget,
    describe_destination,
)
from edge.mission.language.grammar.english import (
    Chain,
    alternatives_of,
    is_numbered,
    is_too_long,
    options_of,
)
from edge.mission.language.words.everyday_words import is_room
from edge.mission.language.words.places import HERE, START
from edge.mission.language.words.spans import shown_s
from edge.mission.logic.ltl import Formula, conj


def orders_of(formula: Formula, destinations: Mapping[str, Destination]) -> str:
    """Return sequences and bans as orders; "" for any other formula.

    Example:
        >>> from edge.mission.logic.ltl import parse
        >>> orders_of(parse('F (mug & F "wait 30 s") & G !dog'), {"wait 30 s": WaitTarget(30.0)})
        'Look for the mug, then wait 30 s. Stay away from the dog.'
    """
    if is_too_long(formula):
        return ""
    parts = formula.args if formula.op == "&" else (formula,)
    bans = [part for part in parts if _ban_of(part)]
    goals = conj(*(part for part in parts if not _ban_of(part)))
    if FailureTarget in map(type, destinations.values()):
        if text := _branches(goals, destinations):
            return _with_bans(text, bans, destinations)
        return ""
    alternatives = alternatives_of(goals)
    if alternatives is None or len(alternatives) != 1 or not all(map(_is_plain, alternatives[0])):
        return ""
    chains = [
        ", then ".join(_order(visit.options[0], destinations) for visit in chain)
        for chain in alternatives[0]
    ]
    text = "; and ".join(chains) + (", in any order" if len(chains) > 1 else "")
    return _with_bans(text, bans, destinations)


def _branches(formula: Formula, destinations: Mapping[str, Destination]) -> str:
    """Return a sequence with fallbacks as orders; "" for any other formula."""
    if formula.op == "|" and len(formula.args) == 2:
        (goal, found), missed = _goal_and_rest(formula.args[0]), formula.args[1]
        for name in goal:
            failed, missed = _goal_and_rest(missed)
            failure = destinations.get(failed[0]) if failed else None
            if not isinstance(failure, FailureTarget) or failure.target != name:
                return ""
        yes, no = (part and _branches(part, destinations) for part in (found, missed))
        if not goal or "" in (yes, no):
            return ""
        described = parse_description(goal[0])
        noun = goal[0] if described is None else described.noun
        is_object = destinations.get(goal[0]) is None and not is_room(noun)
        works, fails = (
            ("it is found", "it is not found") if is_object else ("that works", "that fails")
        )
        text = " or ".join(_order(name, destinations) for name in goal)
        return f"{text}{f'; if {works}, {yes}' if yes else ''}; if {fails}, {no or 'that is all'}"
    if formula.op == "&":
        parts = [_branches(part, destinations) for part in formula.args]
        return " and ".join(parts) + ", in any order" if all(parts) else ""
    goal, rest = _goal_and_rest(formula)
    if not goal or any(isinstance(destinations.get(name), FailureTarget) for name in goal):
        return ""
    text = " or ".join(_order(name, destinations) for name in goal)
    if rest is None:
        return text
    later = _branches(rest, destinations)
    return later and f"{text}, then {later}"


def _goal_and_rest(formula: Formula | None) -> tuple[tuple[str, ...], Formula | None]:
    """Return the goals of F p or F(p & rest), of which one is reached, and the rest.

    Return no goals for another formula.
    """
    if formula is None or formula.op != "F":
        return (), None
    body = formula.args[0]
    first, *later = body.args if body.op == "&" else (body,)
    rest = conj(*(part.args[0] if part.op == "X" else part for part in later)) if later else None
    return options_of(first) or (), rest


def _with_bans(text: str, bans: Sequence[Formula], destinations: Mapping[str, Destination]) -> str:
    for ban in bans:
        away = "out of" if isinstance(destinations.get(_ban_of(ban)), RoomTarget) else "away from"
        text += f". Stay {away} {_with_article(_ban_of(ban))}"
    return f"{text[:1].upper()}{text[1:]}."


def _ban_of(part: Formula) -> str:
    """Return the proposition that `G !x` forbids; "" for other formulas."""
    is_ban = part.op == "G" and part.args[0].op == "!" and part.args[0].args[0].op == "ap"
    return part.args[0].args[0].name if is_ban else ""


def _is_plain(chain: Chain) -> bool:
    return all(visit.times == 1 and len(visit.options) == 1 for visit in chain)


def _order(name: str, destinations: Mapping[str, Destination]) -> str:
    """Return the order to reach one proposition."""
    destination = destinations.get(name)
    if destination is None:
        return f"look for {_with_article(name)}"
    if isinstance(destination, ExploreTarget):
        time = "" if destination.limit_s is None else f" for {shown_s(destination.limit_s)}"
        return f"explore {f'the {destination.room}' if destination.room else 'everything'}{time}"
    if isinstance(destination, WaitTarget):
        return f"wait {destination.shown}"
    if isinstance(destination, CheckTarget):
        checked = re.sub("^check (the )?", "", name)
        return f"check if there is a{'n' * (checked[0] in 'aeiou')} {checked}"
    if name in (START, HERE):
        return "go back to the start" if name == START else "come back to where this mission began"
    if name == CALLER:
        return "come to the caller"
    if isinstance(destination, EveryRoomTarget):
        return f"go into {name}"
    if isinstance(destination, EveryObjectTarget):
        return f"look for {name}"
    if isinstance(destination, RoomTarget) and destination.which != "called":
        return f"go to {describe_destination(name, destination)}"
    return f"go to {_with_article(name)}"


def _with_article(name: str) -> str:
    """Return a name with an article, if it has no number: "the kitchen", "room 12"."""
    return name if is_numbered(name) else f"the {name}"
