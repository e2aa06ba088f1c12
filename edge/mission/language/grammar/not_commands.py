"""Refusal of sentences that look like orders but are not, and of unclear orders."""

from __future__ import annotations

from edge.mission.language.grammar.clause_parts import Clause
from edge.mission.language.words.lexicon import AVOIDING, PAST
from edge.mission.language.words.tokens import PAST_TENSE, REASONS, Token, TokenReader

_ASKING = ("did", "does", "has", "had", "is", "are", "am", "was", "were")  # begin a question
_MAY_I = ("i", "we")  # pronouns of "may I"
# Before "have" and a participle, these reproach: "you should have cleaned it".
_REPROACH = ("should", "could", "would", "might", "may", "supposed", "are supposed")
_HAVING = ("have", "has", "had", "having")
_NO_ORDER = "not an instruction; say for example 'visit the bed'"


def refuse_questions(reader: TokenReader) -> None:
    """Refuse `did you find the bed?`, `may I go to the bed?`, `won't you go to the bed?`.

    "Can you go to the bed" is a request, and "have the robot go there" an order.
    """
    first = reader.peek()
    denied = reader.is_at("not", ahead=1)
    subject = reader.peek(2 if denied else 1)
    asks = first.text in _ASKING
    if subject.kind == "you":
        asks = asks or (first.text in ("do", "have") and not denied and " " not in subject.text)
        asks = asks or (first.kind in ("can", "must") and (denied or subject.text in _MAY_I))
    if asks:
        reader.refuse_finally(_NO_ORDER, first)


def refuse_past_tense(reader: TokenReader, begin: int, verb: Token, clause: Clause) -> None:
    """Refuse `I cleaned the kitchen`, which describes the past; "must have been" does too."""
    at = next(i for i, token in enumerate(reader.tokens) if token is verb)
    before = reader.tokens[begin:at]
    texts = [token.text for token in before]
    past = verb.text.split()[0] in PAST or verb.text == "been" or texts[-1:] == ["been"]
    clause.done = past and bool(set(_HAVING) & set(texts[-3:]))
    if past and not clause.done and not any(token.kind == "be" for token in before):
        reader.refuse_finally(PAST_TENSE, before[0] if before else verb)
    duties = [t for t in before if t.kind in ("must", "ensure") and t.text not in _HAVING]
    if clause.done and (set(_REPROACH) & set(texts) or not duties):
        reader.refuse_finally(PAST_TENSE, before[0])


def refuse_unclear(clause: Clause, reader: TokenReader) -> None:
    """Refuse parts of a clause that no formula over reached objects can express."""
    conditional = [c for c in clause.conditions if c.kind in ("when", "after") and not c.only]
    if clause.in_future and clause.verb.split()[:1] in (["find"], ["see"]):
        reader.refuse_finally("this describes the future; say what to do", clause.token)
    if clause.negated:
        if clause.next_step and not clause.conditions:
            reader.refuse_finally("say directly what not to do", clause.token)
        if clause.mood == "can" and clause.verb in AVOIDING and "anywhere" not in clause.verb:
            reader.refuse_finally(REASONS["needless"], clause.token)
        if clause.ends or clause.verb.startswith(("end ", "finish", "conclude ")):
            reader.refuse_finally("say where the mission ends", clause.token)
        if clause.count and clause.targets and clause.targets.names == ("room",):
            reader.refuse_finally("say which", clause.token)
        again = clause.again or clause.returns
        if again and any(c.kind in ("until", "unless", "before") for c in clause.conditions):
            reader.refuse_finally("say it without 'again'", clause.token)
        if conditional and len(clause.conditions) > len(conditional):
            reader.refuse_finally("use two sentences", conditional[0].token)
        return
    if conditional and clause.first:
        reader.refuse_finally("say 'before you go there, …'", clause.token)
    if conditional and clause.through and any(c.kind == "when" for c in conditional):
        reader.refuse_finally("say 'to get there, go through …'", clause.token)
    if conditional and clause.done:
        reader.refuse_finally("say 'visit … before …'", clause.token)
    if clause.first and clause.targets and clause.targets.listed:
        reader.refuse_finally("unclear which one is first; say 'first …, then …'", clause.token)
    if conditional and clause.verb == "" and clause.leads:
        reader.refuse_finally("say what to do then, as in 'go to the bed'", conditional[0].token)
    groups = clause.targets.groups if clause.targets else ()
    if clause.count and clause.count.least > 1 and (clause.order and len(groups) > 1):
        hint = "unclear: this number for the entire list, or for each? use two sentences"
        reader.refuse_finally(hint, clause.token)
    if any(c.recurring for c in conditional) and (len(clause.conditions) > 1 or clause.avoiding):
        reader.refuse_finally("use two sentences", conditional[0].token)
