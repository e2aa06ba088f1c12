"""Parser of objects on the way: `go to b through a`, `to reach b, go through a`."""

from __future__ import annotations

from edge.mission.language.grammar.clause_parts import Clause, skip_particles
from edge.mission.language.words.noun_phrases import (
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import Token, TokenReader

PASSING = ("through", "past", "along", "across", "via", "by", "over")
"""Particles after which a verb of motion means "pass": "walk past", "drive through"."""

_PARTICIPLES = ("passing", "crossing", "traversing", "using", "taking")  # their object is passed
# "by" before these means "by way of": "go up by the stairs".
RIDDEN = ("stairs", "staircase", "elevator", "lift", "escalator", "ladder", "ramp", "bridge")
_ANYWHERE = (  # words for any place before an exception: "any room but a"
    "room", "area", "place", "space", "square", "door", "way", "path", "route", "zone", "region",
)  # fmt: skip
_SETS_OUT = ("go", "move", "head", "travel", "walk", "drive", "fly")  # verbs of "when you go to"
_ANY = ("any", "only", "a", "the", "some")  # words before one of `_ANYWHERE`


def take_route(reader: TokenReader, memory: Antecedents, clause: Clause) -> bool:
    """Parse `via a`, `, passing a` or `only through a` after a goal; return False if none comes."""
    length, only = _way_length(reader)
    if not length or clause.targets is None:
        return False
    token = reader.peek()
    if clause.negated:
        hint = "to exclude a path, say 'go to … without going through …'"
        reader.refuse(hint, token)
    if clause.several_ways:
        reader.refuse("use two sentences", token)
    reader.at += length
    reader.skip("first", "filler")
    only = only or bool(reader.take("only"))
    if (other := take_exception(reader, memory)) is not None:
        clause.avoiding.append(other)
        return True
    if len(clause.targets.groups) > 1:
        reader.refuse("unclear which one this is on the way to; use two sentences", token)
    add_to_route(reader, clause, take_noun_phrase(reader, memory), token)
    ahead = 1 if reader.is_at("comma") else 0
    then = reader.peek(ahead)
    if then.kind == "then" and starts_noun_phrase(reader, ahead + 1) and reader.pick(then, 2) == 1:
        reader.at += ahead + 1  # "via the sofa and then the bed": both may be on the way
        add_to_route(reader, clause, take_noun_phrase(reader, memory), then)
    while then.kind == "then" and _way_length(reader, ahead + 1)[0]:
        reader.at += ahead + 1
        reader.at += _way_length(reader)[0]  # "through the sofa and then through the bed"
        add_to_route(reader, clause, take_noun_phrase(reader, memory), then)
        ahead = 1 if reader.is_at("comma") else 0
        then = reader.peek(ahead)
    clause.only_way = clause.only_way or only or bool(reader.take("only"))
    return True


def _way_length(reader: TokenReader, begin: int = 0) -> tuple[int, bool]:
    """Return the number of tokens before a passed object (0 if none), and True if one is "only"."""
    ahead = begin + (1 if reader.is_at("comma", ahead=begin) else 0)
    after_comma = ahead > begin
    only = reader.is_at("only", ahead=ahead)
    ahead += only
    token, follower = reader.peek(ahead), reader.peek(ahead + 1)
    if token.kind == "via" or (token.text in PASSING[:4] and (only or not after_comma)):
        return ahead + 1, only
    if token.text == "by" and (follower.text in RIDDEN or reader.peek(ahead + 2).text in RIDDEN):
        return ahead + 1, only
    if token.text in _PARTICIPLES:
        return ahead + (2 if follower.text in PASSING else 1), only
    passes = follower.text in PASSING[:4] or follower.kind == "via"
    if token.kind == "verb" and token.text.endswith("ing") and passes:
        return ahead + 2, only
    return 0, False


def add_to_route(reader: TokenReader, clause: Clause, passed: NounPhrase, token: Token) -> None:
    """Add the passed objects to the route of a clause; after "and", their order is a choice."""
    several = len(passed.groups) > 1 and not passed.listed and not clause.order
    clause.several_ways = len(passed.groups) > 1
    if several and reader.pick(token, 2) == 1:
        clause.route.append(passed)
    else:
        clause.route += [NounPhrase((group,)) for group in passed.groups]


def is_destination_ahead(reader: TokenReader, clause: Clause) -> bool:
    """Return True if a destination comes here: "on the way to x", "to reach x"."""
    if reader.peek().text in ("when", "while") and reader.peek(1).text == "you":
        goes = reader.peek(2).text in _SETS_OUT and reader.is_at("to", ahead=3)
        return goes and (clause.negated or clause.mood != "must")  # "pass a when you go to b"
    return reader.is_at("bound") or (reader.is_at("to") and reader.is_at("verb", ahead=1))


def take_bound(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse `go through x to reach y` (x, then y) or `avoid x on the way to y` (y without x)."""
    token = reader.peek()
    reader.at += 1
    reader.skip("you")
    while reader.take("verb"):
        skip_particles(reader, clause)
    clause.bound_by = token
    set_destination(reader, memory, clause, take_noun_phrase(reader, memory), token)


def set_destination(
    reader: TokenReader, memory: Antecedents, clause: Clause, bound: NounPhrase, token: Token
) -> None:
    """Make the objects of a clause part of the way to its destination `bound`."""
    if clause.targets is None:
        reader.refuse("expected something to do or to avoid here", token)
    if not clause.negated:
        add_to_route(reader, clause, clause.targets, token)
        clause.targets = bound
    elif clause.conditions or clause.count or clause.avoiding:
        reader.refuse("use two sentences", token)
    else:
        clause.avoiding.append(clause.targets)
        clause.targets, clause.negated, clause.elsewhere = bound, False, False
        clause.mood = "do"  # the destination is an order, not a permission
    memory.named = clause.targets
    memory.ask(clause.targets)


def take_exception(reader: TokenReader, memory: Antecedents) -> NounPhrase | None:
    """Parse `any room but a` or `the room that is not a`; return the exception, or None."""
    ahead = 0
    while reader.peek(ahead).text in _ANY:
        ahead += 1
    several = reader.peek(ahead - 1).text in ("any", "only") if ahead else False
    if reader.peek(ahead).text == "non":
        ahead += 1
    else:
        kind = reader.peek(ahead).text
        if kind.removesuffix("s") not in _ANYWHERE:
            return None
        several = several or kind.endswith("s")
        ahead += 1
        token, follower = reader.peek(ahead), reader.peek(ahead + 1)
        if token.text in ("that", "which") and follower.kind == "be":
            if not reader.is_at("not", ahead=ahead + 2):
                return None
            ahead += 3
        elif (token.text in ("that", "which") and follower.kind == "not") or (
            token.text,
            follower.text,
        ) == ("other", "than"):  # "that isn t"
            ahead += 2
        elif token.text == "except":
            ahead += 2 if follower.text == "for" else 1
        else:
            return None
    reader.at += ahead
    return take_noun_phrase(reader, memory, banned=True)
