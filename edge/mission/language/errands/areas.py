"""Orders to look in one place after another: "look in the office, then in the hall"."""

from __future__ import annotations

import re

from edge.mission.language.words.everyday_words import (
    NAME,
    bare,
    each_kind,
    is_room,
    phrase_of,
    refuse_each,
)
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.tokens import unclear

JOINT = r"(?:[\s,;.!?:-]|\b(?:and|but|or|then|so)(?=[\s,]|$))+"
"""Regular expression for the marks and words between two orders."""
_FOR_IT = r"(?:\s+(?:for\s+(?:it|them|one|him|her)|again|also|too|as well|next))*"
AREA = re.compile(
    r"(?:(?:go|then|also|and|next)\s+)*"
    rf"(?:(?P<verb>look|search|try|check|hunt|(?:have|take) a look){_FOR_IT}\s+)?"
    rf"(?:(?P<relation>{phrase_of('relation')})\s+)?(?P<anchor>{NAME}){_FOR_IT}"
    r"(?=[,.;!?]|$|\s+(?:and|then|or)\b)",
    re.I,
)
"""A place to look in."""
_FIND_IT = re.compile(
    rf"^(?:(?:go|and|look)\s+)*(?:find|for|search for|locate|hunt for)\s+(?:it|them|one)"
    rf"(?=\s+{phrase_of('relation')}\s)",
    re.I,
)
_GO_AND_LOOK = re.compile(
    rf"^(?:go|drive|head) (?:over )?(?:to|in|into) (?P<room>{NAME}),? and (?:then )?"
    r"(?:look|search|check)(?: for (?:it|them|one))?(?: in)?(?: there)?"
    r"(?=[,.;!?]|$| (?:and|then)\b)",
    re.I,
)
_SEARCHED = re.compile(rf"\b(?:find|look for|search for|locate)\s+(?P<object>{NAME})", re.I)


def areas_of(text: str, noun: str) -> tuple[list[str], str]:
    """Return the orders to look for an object in one place after another, and the rest of a text.

    Example:
        >>> areas_of("look in the office, then in the hall, and come back", "the mug")
        (['find the mug in the office', 'find the mug in the hall'], 'come back')
    """
    orders: list[str] = []
    text = _GO_AND_LOOK.sub(r"look in \g<room>", _FIND_IT.sub("look", text))
    at = 0
    while found := AREA.match(text, at):
        relation, verb = found["relation"], (found["verb"] or "try").lower()
        anchor = found["anchor"]
        is_order = not found["verb"] and TABLE.get((anchor.split()[0].lower(),)) == "verb"
        in_room = verb in ("try", "check", "search") and is_room(bare(anchor)) and not is_order
        if each_kind(anchor) and not is_order:
            if each_kind(anchor) != "room":
                refuse_each(anchor)
            orders.append(f"find {noun}")
        elif not (relation or in_room):
            if found["verb"]:
                hint = "unclear where to look; say 'look on the …' or 'look in the …'"
                raise unclear(found[0], hint)
            break
        else:
            orders.append(f"find {noun} {relation or 'in'} {anchor}")
        joint = re.compile(JOINT, re.I).match(text, found.end())
        at = joint.end() if joint else found.end()
    return orders, text[at:].strip(" ,.;!?")


def searched_object(text: str) -> str:
    """Return the object that an order searches for; "" if there is none."""
    found = _SEARCHED.search(text)
    return found["object"] if found else ""
