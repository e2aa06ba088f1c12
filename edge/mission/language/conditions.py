"""Conditions: `until the bed is reached`, `once you have visited it`, `before that`."""

from __future__ import annotations

from edge.mission.language.counts import take_count
from edge.mission.language.spoken import (
    AUXILIARIES,
    CONDITIONS,
    PREDICATE,
    Clause,
    Condition,
    Memory,
    skip_particles,
    take_mood,
)
from edge.mission.language.things import Things, starts_things, take_things
from edge.mission.language.words import Reader, Token


def take_condition(reader: Reader, memory: Memory, clause: Clause) -> Condition:
    only = denied = False
    if limit := reader.take("only", "not"):
        only, denied = limit.kind == "only", limit.kind == "not"
    token = reader.take(*CONDITIONS)
    assert token is not None
    kind = "when" if token.kind == "once" else token.kind
    if token.text.startswith("as soon"):
        clause.next_step = True
        if reader.peek().text == "as":
            reader.at += 1
    recurring = token.text in ("whenever", "every time", "each time", "any time", "if", "if ever")
    condition = Condition(kind, token, Things(()), only, denied, recurring)
    _take_happening(reader, memory, condition)
    return condition


def _take_happening(reader: Reader, memory: Memory, condition: Condition) -> None:
    """`you have visited a`, `a is visited`, `visiting a`, `a`, `that`, `then`."""
    if (
        reader.sees("then")
        and reader.peek().text == "then"
        and condition.kind in ("before", "until")
    ):
        reader.at += 1
        condition.things = _asked(reader, memory, condition.token)
        return
    says = Clause(reader.peek())
    take_mood(reader, says)
    been = reader.sees("to") and reader.tokens[reader.at - 1].text == "been"
    if been or reader.sees("verb"):
        reader.skip("verb")
        skip_particles(reader, says)
        if not starts_things(reader):
            reader.refuse("expected the name of a thing here")
        condition.things = take_things(reader, memory.named)
        reader.take("happen")
    elif reader.sees("all of") and reader.sees(*AUXILIARIES, "pronoun", ahead=1):
        everything = reader.take("all of")
        assert everything is not None
        reader.take("pronoun")
        condition.things = _asked(reader, memory, everything)
        _take_predicate(reader, says)
    elif reader.sees("pronoun"):
        pronoun = reader.take("pronoun")
        assert pronoun is not None
        condition.things = _asked(reader, memory, pronoun)
        _take_predicate(reader, says)
    elif starts_things(reader):
        condition.things = take_things(reader, memory.named, subject=True)
        while _take_predicate(reader, says) and _another_subject(reader):
            reader.skip("and")
            more = take_things(reader, memory.named, subject=True)
            condition.things = Things(condition.things.groups + more.groups)
    elif condition.kind in ("before", "after") and memory.asked:
        condition.things = memory.asked  # "do not go to b before": before what was asked
    else:
        reader.refuse("expected what must have happened here", condition.token)
    condition.denied = condition.denied or says.negated
    reader.skip("filler", "first")
    condition.count = take_count(reader, negated=False)


def _asked(reader: Reader, memory: Memory, token: Token) -> Things:
    things = memory.asked
    if things is None:
        reader.refuse(f"nothing was named before that {token.text!r} could mean", token)
    return things


def _take_predicate(reader: Reader, says: Clause) -> bool:
    """`has been visited`, `occurs`; False, and nothing taken, when there is none."""
    begin = reader.at
    said = take_mood(reader, says, PREDICATE)
    if reader.take("happen") or (said & AUXILIARIES and reader.take("verb")):
        return True
    reader.at = begin
    return False


def _another_subject(reader: Reader) -> bool:
    """Whether "and b is visited" goes on the same condition."""
    if not (reader.sees("and") and starts_things(reader, 1)):
        return False
    ahead = 1
    while reader.sees("word", "quoted", "article", ahead=ahead):
        ahead += 1
    if not reader.sees("be", ahead=ahead):
        return False
    while reader.sees("be", "filler", ahead=ahead):
        ahead += 1
    return reader.sees("verb", ahead=ahead)
