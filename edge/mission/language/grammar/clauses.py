"""Parser of one clause: who must (not) do what, how often, under which conditions.

clause    = { condition [","] } { mood } ( action | passive | bare ) { adjunct }
action    = verb { verb } particles objects | avoid [verb] objects
passive   = objects { mood } ( verb | avoid | "happen" )
bare      = objects                      (after another clause: ", then a tv")
adjunct   = order | count | condition | "while avoiding" objects | "without" [verb] objects
condition = ("before" | "after" | "until" | "unless" | "when" | "once") happening
happening = ["you" mood] verb objects | objects [mood (verb | "happen")] | pronoun
"""

from __future__ import annotations

from typing import Literal

from edge.mission.language.grammar.action import (
    UP,
    each_of,
    goes_on_to,
    is_passing,
    take_action,
    take_passed,
    take_until,
)
from edge.mission.language.grammar.adjuncts import intersect_counts, take_adjunct, take_avoiding
from edge.mission.language.grammar.clause_parts import (
    AUXILIARIES,
    CONDITIONS,
    MOOD,
    ORDERS,
    PREDICATE,
    Clause,
    Condition,
    skip_particles,
    take_count,
    take_mood,
    take_quota,
)
from edge.mission.language.grammar.conditions import STATES, take_condition
from edge.mission.language.grammar.not_commands import refuse_past_tense, refuse_unclear
from edge.mission.language.grammar.routes import set_destination
from edge.mission.language.words import nouns
from edge.mission.language.words.naming import is_indefinite
from edge.mission.language.words.noun_phrases import (
    COUNTING,
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import (
    NONE_OR_NOT_ALL,
    ONE_ROBOT,
    ONLY_REACHED,
    PAST_TENSE,
    REASONS,
    Token,
    TokenReader,
)

Bare = Literal["yes", "known", "no"]
"""Permission of a clause without a verb; see `take_clause`."""
_SAY_WHAT = "say what to do, as in 'visit the bed'"
_PERFORM = ("make", "complete", "perform", "have")
_OPENINGS = ("no return", "quota", "onward", "opener", "origin", "on the way", "bound", "around")
_PLACE_PREPOSITIONS = ("in", "inside", "at", "on", "near")
# "any visit to", "each trip to"
_ANY_VISIT = tuple(
    f"{every} {visit} to" for every in ("any", "every", "each", "a") for visit in ("visit", "trip")
)


def starts_clause(reader: TokenReader, ahead: int = 0) -> bool:
    """Return True if a clause can begin at that token."""
    if reader.is_at("to", ahead=ahead):
        ahead += 1
    if starts_noun_phrase(reader, ahead) or is_passing(reader, ahead):
        return True
    if reader.peek(ahead).text in ("at", "in") and starts_noun_phrase(reader, ahead + 1):
        return True
    goes_on = reader.peek(ahead).text == "on" or reader.is_at("again", ahead=ahead)
    if goes_on and reader.is_at("to", ahead=ahead + 1):
        return True
    if reader.peek(ahead).text == "from" or reader.is_at("while", "without", ahead=ahead):
        return True
    return reader.is_at(
        *MOOD, *CONDITIONS, *ORDERS, *_OPENINGS, "verb", "avoid", "immediately", "banned",
        ahead=ahead,
    )  # fmt: skip


def take_clause(reader: TokenReader, memory: Antecedents, bare: Bare) -> Clause:
    """Parse the clause that begins here.

    `bare`: "yes" allows a clause without a verb, "known" only if it names known objects.

    Raises:
        TranslationError: no clause begins here.
    """
    clause = Clause(reader.peek())
    begin, starts = reader.at, reader.at == 0 or reader.is_at("stop", ahead=-1)
    _take_opening(reader, memory, clause)
    if reader.at > begin and reader.tokens[reader.at - 1].kind in ("opener", "on the way"):
        bare, starts = "yes", False
    if reader.at > begin and reader.peek().text in ("though", "however"):
        reader.at += 1
    if reader.is_at("end", "stop") and _take_restriction(memory, clause):
        return clause
    # "Visiting the bed …" at the start of a sentence is no order, but "bring" is.
    gerund = starts and reader.is_at("verb") and reader.peek().text.endswith("ing")
    gerund = gerund and reader.peek().text != "bring"
    take_mood(reader, clause)
    before = reader.tokens[reader.at - 1]
    if reader.at > begin and before.kind == "ensure" and before.text.endswith(" is"):
        bare = "yes"  # "the goal is the bed"
    if before.text in ("do", "does", "did") and reader.is_at("pronoun"):
        reader.refuse("say what to visit", reader.peek())  # "do that again"
    main: Token | None = reader.peek()  # mostly the verb
    opening = reader.tokens[begin : reader.at]  # the tokens before the verb
    clause.subject = any(t.kind in ("you", "ensure") for t in opening)
    clause.in_future = any(
        t.text == "will" or (t.kind == "can" and clause.negated) for t in opening
    )
    clause.agent = next((t.text for t in opening if t.kind == "you" and " " in t.text), "")
    if opening and opening[-1].kind == "must" and starts_noun_phrase(reader):
        reader.refuse_finally(_SAY_WHAT, clause.token)  # "I have a sofa"
    if reader.peek().text in _PERFORM and reader.is_at(*COUNTING, ahead=1):
        reader.at += 1
    # The action: a count, a verb, a place after "be", names with a predicate, or only names.
    count_at = reader.peek()
    if (count := take_count(reader, clause.negated)) is not None:  # "at least two visits to a"
        clause.count = intersect_counts(reader, clause.count, count, count_at)
        reader.skip("to")
        clause.targets = take_noun_phrase(reader, memory)
    elif reader.is_at("verb", "avoid") or goes_on_to(reader):
        take_action(reader, memory, clause)
    elif _is_there(reader):
        clause.verb = "be"
        reader.at += 2 if reader.peek().text == "over" else 1
        if clause.negated and reader.is_at("all of"):
            reader.refuse_finally(NONE_OR_NOT_ALL)
        clause.targets = take_noun_phrase(reader, memory, banned=clause.negated)
    elif reader.is_at("quota"):
        take_quota(reader, memory, clause)
    elif reader.is_at("onward"):
        take_until(reader, memory, clause)
    elif starts_noun_phrase(reader):
        _take_passive(reader, memory, clause, bare)
    elif before.kind == "be" and reader.peek().text in _PLACE_PREPOSITIONS:
        reader.refuse_finally("this describes a place; say where to go", clause.token)
    elif before.text.endswith(("done", "finished")) and reader.peek().text in _PLACE_PREPOSITIONS:
        reader.refuse_finally("say 'after …'", before)
    elif bare == "yes" and reader.peek().text in ("at", "in") and starts_noun_phrase(reader, 1):
        reader.at += 1  # "…, and after that at the bank"
        clause.targets = take_noun_phrase(reader, memory)
    elif bare == "yes" and reader.peek().text in ("back", *UP) and starts_clause(reader):
        skip_particles(reader, clause)
        clause.targets = take_noun_phrase(reader, memory)
    elif (bare != "no" or clause.negated) and is_passing(reader):
        reader.at += 1
        take_passed(reader, memory, clause)
    elif reader.is_at("to") and starts_noun_phrase(reader, 1) and (bare != "no" or clause.negated):
        reader.take("to")
        clause.targets = take_noun_phrase(reader, memory, banned=clause.negated)
    else:
        reader.refuse("expected something to do or to avoid here")
    if opening and any(t.text == "been" for t in opening[-2:]):
        refuse_past_tense(reader, begin, opening[-1], clause)
    if main is not None and main.kind == "verb":
        refuse_past_tense(reader, begin, main, clause)
    if clause.targets:
        memory.named = clause.targets
        if not clause.negated and clause.mood != "can":
            memory.ask(clause.targets)
    asked = memory.asked
    if clause.bound:
        set_destination(reader, memory, clause, clause.bound, clause.token)
    while take_adjunct(reader, memory, clause):
        pass
    if any(word in clause.verb.split() for word in ("last", "final")):
        clause.ends = True  # "your last stop is the bed"
    if clause.always:
        for condition in clause.conditions:
            condition.recurring = True
    if clause.always and not (clause.negated or clause.avoiding or clause.conditions):
        reader.refuse_finally(
            "a mission ends, so 'always' is not possible for a visit", clause.always
        )
    if gerund and not any(t.kind in ("banned", "must") for t in reader.tokens[begin : reader.at]):
        reader.refuse("not an instruction; say for example 'visit the bed'", clause.token)
    refuse_unclear(clause, reader)
    if clause.negated and clause.first and not clause.conditions and not clause.count:
        own = clause.targets.names if clause.targets else ()
        others = [name for name in asked.names if name not in own] if asked else []
        if not others:
            reader.refuse("say 'do not visit … before …'", clause.token)
        any_other = NounPhrase((tuple(others),))
        clause.conditions.append(Condition("before", clause.token, any_other))  # "not b first"
        clause.first = False
    return clause


def _is_there(reader: TokenReader) -> bool:
    """Return True if a place follows "be", "i want you" or "you are not allowed": "in the hall"."""
    before, token = reader.tokens[reader.at - 1], reader.peek()
    if reader.at and before.text.endswith(" from") and before.kind == "not":
        return starts_noun_phrase(reader)
    over = 1 if token.text == "over" else 0
    placed = reader.peek(over).text in _PLACE_PREPOSITIONS and starts_noun_phrase(reader, over + 1)
    wanted = before.kind == "ensure" and "careful" not in before.text and "care" not in before.text
    asked = before.text in ("be", "been") or wanted or before.kind in ("not", "can")
    asked = asked or (before.kind == "banned" and "ed" in before.text)
    return bool(reader.at) and placed and asked  # "the robot is in the hall" asks for nothing


def _take_restriction(memory: Antecedents, clause: Clause) -> bool:
    """Turn a clause without an action into a restriction of all clauses before it.

    Examples are `…, without entering x`, `…, without going back` and `…, but only after x`. Return
    False if the clause is no restriction.
    """
    avoided = [*clause.avoiding, *clause.never]
    clause.negated = True
    clause.targets = NounPhrase(tuple(group for targets in avoided for group in targets.groups))
    clause.avoiding, clause.never = [], []
    return bool(clause.each or avoided) and not clause.conditions


def _take_opening(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse what may stand before a clause: an order, conditions."""
    while True:
        token = reader.peek()
        if token.kind == "all of" and reader.is_at("without", "while", ahead=1):
            reader.at += 1  # "…, all without visiting b"
            continue
        ahead = 1 if reader.is_at("only", "immediately", "filler") else 0
        if token.kind in ORDERS:
            clause.order = token.kind
            reader.at += 1
        elif token.kind in ("while", "without") and not clause.conditions:
            take_avoiding(reader, memory, clause)
            if token.kind == "while":  # of all that follows
                clause.never, clause.avoiding = [*clause.never, *clause.avoiding], []
        elif token.kind in ("always", "in the end"):
            clause.always = token if token.kind == "always" else clause.always
            clause.ends = clause.ends or token.kind == "in the end"
            reader.at += 1
        elif token.kind in ("opener", "on the way"):
            clause.first = clause.first or token.kind == "opener"
            clause.enroute = clause.enroute or token.kind == "on the way"
            reader.at += 1
        elif token.kind == "bound" or (
            token.kind == "to" and reader.is_at("verb", ahead=1) and not clause.bound
        ):
            reader.at += 1
            while reader.take("verb"):
                skip_particles(reader, clause)
            clause.bound = take_noun_phrase(reader, memory)
        elif reader.is_at(*CONDITIONS, ahead=ahead):
            if token.kind in ("immediately", "filler"):
                at_once = token.kind == "immediately" or token.text == "directly"
                clause.next_step = clause.next_step or at_once
                reader.at += 1
            condition = take_condition(reader, memory, clause)
            clause.conditions.append(condition)
            memory.named = condition.targets
        else:
            return
        reader.skip("comma")
        if clause.conditions and reader.peek().text == "then":
            reader.at += 1  # "if …, then …"
            clause.leads = True


def _take_passive(reader: TokenReader, memory: Antecedents, clause: Clause, bare: Bare) -> None:
    """Parse `a and b must be visited`, or only names."""
    start = reader.peek()
    begin = reader.at
    if clause.negated and start.kind == "all of":
        reader.refuse_finally(NONE_OR_NOT_ALL, start)
    targets = take_noun_phrase(reader, memory, subject=True, banned=clause.negated)
    if start.text in _ANY_VISIT and _take_consequence(reader, memory, clause, start, targets):
        return
    inner = Clause(start)
    mood_kinds = take_mood(reader, inner, PREDICATE)
    texts = [token.text for token in reader.tokens[begin : reader.at]]
    ends = reader.is_at("comma", "stop", "end", "and", "but", "then")
    if inner.first and ends:  # "the bank must be first"
        clause.first, clause.negated = True, clause.negated != inner.negated
        clause.verb, clause.targets = "be", targets
        return
    done = "been" in texts and not {"must", "should", "shall"} & set(texts)
    if "been" in texts and any(c.kind == "when" for c in clause.conditions):
        reader.refuse_finally("say 'visit … before …'", start)
    if done and not clause.conditions:
        reader.refuse_finally(PAST_TENSE, start)  # "the hall has been mopped"
    barred = any(token.kind == "banned" for token in reader.tokens[begin : reader.at])
    if targets.listed and bare == "yes" and (barred or mood_kinds & AUXILIARIES):
        reader.at = begin  # "…, then a, the hallway is off limits"
        clause.targets = take_noun_phrase(reader, memory)
        return
    avoid = reader.take("avoid")
    if start.kind == "either" and (avoid or inner.negated):
        reader.refuse_finally("say which to avoid", start)
    if "be" in mood_kinds and reader.peek().text in STATES:
        reader.refuse_finally(ONLY_REACHED, start)
    verb = avoid or reader.take("verb", "happen")
    if barred and verb is not None:  # "the cat is forbidden to enter the kitchen"
        reader.refuse_finally(ONE_ROBOT, start)
    if "be" in mood_kinds and reader.peek().text in _PLACE_PREPOSITIONS:
        reader.refuse_finally("the robot can only go to objects", start)  # "the dog must be in b"
    if barred and verb is None:  # "the hallway is off limits"
        clause.negated, clause.verb = clause.negated != inner.negated, "be"
        clause.targets = each_of(targets)
        return
    if avoid and inner.mood == "can" and not inner.negated:
        reader.refuse_finally(REASONS["needless"], start)
    if verb is not None and (mood_kinds & AUXILIARIES or verb.kind == "happen"):
        clause.mood = inner.mood if inner.mood != "do" else clause.mood
        clause.negated = clause.negated != (inner.negated != bool(avoid))
        clause.only, clause.first = clause.only or inner.only, clause.first or inner.first
        clause.verb = verb.text
        clause.targets = each_of(targets) if clause.negated else targets
        return
    reader.at = begin
    # No predicate came: these are only names, as in "…, then the bed".
    named = start.kind != "word" or is_indefinite(reader) or _well_known(reader, memory)
    if not (named and (bare == "yes" or clause.negated)) and not (
        bare == "known" and _well_known(reader, memory)
    ):
        reader.refuse("unknown verb", start)
    clause.targets = take_noun_phrase(reader, memory, banned=clause.negated)
    if reader.is_at("not") and reader.peek().text.endswith(("allowed", "permitted")):
        reader.refuse_finally(ONE_ROBOT, start)  # "guests are not allowed in b"
    if reader.is_at("verb") and reader.peek().text.split()[0].endswith("s"):
        reader.refuse_finally(_SAY_WHAT, start)  # "the path goes through b"


def _take_consequence(
    reader: TokenReader, memory: Antecedents, clause: Clause, start: Token, targets: NounPhrase
) -> bool:
    """Parse `any visit to a must be followed by a visit to b`; return False if it does not come."""
    begin = reader.at
    reader.skip("must", "to", "be", "always")
    clause.next_step = bool(reader.take("immediately"))
    if reader.peek().text != "followed by":
        reader.at, clause.next_step = begin, False
        return False
    reader.at += 1
    reader.skip("verb", "to")
    clause.mood = "must"
    clause.conditions.append(Condition("when", start, targets, recurring=True))
    clause.targets = take_noun_phrase(reader, memory)
    return True


def _well_known(reader: TokenReader, memory: Antecedents) -> bool:
    """Return True if the following names can only be names, so that they need no verb."""
    begin = reader.at
    targets = take_noun_phrase(reader, memory)
    reader.at = begin
    return all(len(name) == 1 or nouns.unknown_in(name.split()) is None for name in targets.names)
