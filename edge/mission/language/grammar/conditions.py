"""Parser of conditions: `until the bed is reached`, `once you have visited it`, `before that`."""

from __future__ import annotations

from edge.mission.language.grammar.clause_parts import (
    AUXILIARIES,
    CONDITIONS,
    PREDICATE,
    Clause,
    Condition,
    skip_particles,
    take_count,
    take_mood,
)
from edge.mission.language.words.naming import refuse_missing_name
from edge.mission.language.words.noun_phrases import (
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import ONLY_REACHED, TokenReader

STATES = (
    "open", "closed", "close", "locked", "empty", "clean", "shut", "unlocked", "blocked", "broken",
    "mopped",
)  # fmt: skip
"""Verb forms that also describe the state of an object."""


def take_condition(reader: TokenReader, memory: Antecedents, clause: Clause) -> Condition:
    """Parse `until the bed is reached`, `once you have visited it`, `before that`.

    The reader is at its first word, or at "only" or "not" before it. "As soon as" sets
    `clause.soon`.

    Raises:
        TranslationError: the condition is incomplete, unclear or not supported.
    """
    only = denied = False
    if limit := reader.take("only", "not"):
        only, denied = limit.kind == "only", limit.kind == "not"
    token = reader.take(*CONDITIONS)
    assert token is not None
    kind = "when" if token.kind == "once" else token.kind
    if token.text.startswith("as soon"):
        clause.soon = True
    recurring = token.text in ("whenever", "every time", "each time", "any time", "if", "if ever")
    condition = Condition(kind, token, NounPhrase(()), only, denied, recurring)
    begin = reader.at
    take_happening(reader, memory, condition)
    # "Go to a, but go to b before that": the last goal is b, the clause's own, so "that" is a.
    if condition.targets is clause.targets and kind in ("before", "after") and memory.previous:
        condition.targets = memory.previous
    if kind in ("after", "when") and any(
        t.text == "ever" for t in reader.tokens[begin : reader.at]
    ):
        condition.recurring = True  # "after you ever see a cat"
    return condition


def take_happening(reader: TokenReader, memory: Antecedents, condition: Condition) -> None:
    """Parse the event of a condition: `you have visited a`, `a is visited`, `visiting a`."""
    inner = Clause(reader.peek())  # only collects the event's "not" and "first"
    mood_kinds = take_mood(reader, inner)
    inside = reader.peek().text in ("in", "inside", "at", "on") and starts_noun_phrase(reader, 1)
    if inside and ("be" in mood_kinds or (condition.kind == "when" and not mood_kinds)):
        reader.at += 1  # "once you are in the kitchen", "once in the kitchen"
        _refuse_denied(reader, condition, inner)
        condition.targets = take_noun_phrase(reader, memory)
        condition.denied = condition.denied or inner.negated
        return
    been = reader.is_at("to") and reader.tokens[reader.at - 1].text == "been"
    # "Never enter a, unless going to b": this allows a only on the way to b.
    if condition.kind == "unless" and reader.peek().text.startswith("going"):
        reader.refuse_finally("use two sentences for 'only to get to …'", condition.token)
    if been or reader.is_at("verb"):
        participle = reader.peek().text.split()[0].endswith("ing")
        condition.going = condition.token.text == "when" and participle  # "when passing a"
        reader.skip("verb")
        skip_particles(reader, inner)
        if not starts_noun_phrase(reader):
            refuse_missing_name(reader)
        condition.targets = take_noun_phrase(reader, memory)
        while participle and another_participle(reader):
            skip_particles(reader, inner)
            more = take_noun_phrase(reader, memory)
            condition.targets = NounPhrase(condition.targets.groups + more.groups)
        reader.take("happen")
    elif reader.is_at("pronoun"):
        if memory.asked is None:
            hint = f"{reader.peek().text!r} refers to nothing that was named before"
            reader.refuse(hint, reader.peek())
        reader.at += 1
        condition.targets = memory.asked
        # "before it" means the order of goals; "before it is visited" names an event.
        condition.referred = not _take_predicate(reader, inner)
    elif starts_noun_phrase(reader):
        condition.targets = take_noun_phrase(reader, memory, subject=True)
        _take_predicate(reader, inner)
    elif condition.kind in ("before", "after") and memory.asked and _ends(reader):
        condition.targets = memory.asked  # "do not go to b before": before what was asked
        condition.referred = True
    else:
        reader.refuse("expected a condition here", condition.token)
    _refuse_denied(reader, condition, inner)
    condition.denied = condition.denied or inner.negated
    first = bool(reader.take("first")) or inner.first
    if first and reader.is_at("then") and not reader.is_at("end", ahead=1):
        reader.refuse_finally("use two sentences", condition.token)
    if first and condition.recurring:
        reader.refuse_finally("unclear before what; use two sentences", condition.token)
    reader.skip("filler", "first")
    condition.count = take_count(reader, negated=False)


def _refuse_denied(reader: TokenReader, condition: Condition, inner: Clause) -> None:
    """Refuse "until you have not been to a", "unless you are not in a"."""
    if inner.negated and condition.kind != "when":
        reader.refuse_finally("say it without 'not'", condition.token)


def another_participle(reader: TokenReader) -> bool:
    """Skip "and passing", which continues "after crossing a and passing b".

    Return False, and take nothing, if it does not come.
    """
    verb = reader.peek(1)
    participle = verb.kind == "verb" and verb.text.split()[0].endswith("ing")
    goes_on = reader.is_at("and", "or") and participle
    if goes_on:
        reader.at += 2
    return goes_on


def _ends(reader: TokenReader) -> bool:
    """Return True if the phrase ends here."""
    return reader.is_at("comma", "stop", "end", "and", "or", "but", "then", "filler", "first")


def _take_predicate(reader: TokenReader, inner: Clause) -> bool:
    """Skip `has been visited` or `occurs`; return False, and take nothing, if it does not come."""
    begin, negated = reader.at, inner.negated
    mood_kinds = take_mood(reader, inner, PREDICATE)
    if reader.take("happen"):
        return True
    if mood_kinds & AUXILIARIES and reader.is_at("verb"):
        if mood_kinds <= {"be", "not"} and reader.peek().text in STATES:
            reader.refuse_finally(ONLY_REACHED)
        reader.take("verb")
        return True
    if "be" in mood_kinds and not _ends(reader):
        reader.refuse_finally(ONLY_REACHED)
    reader.at, inner.negated = begin, negated
    return False
