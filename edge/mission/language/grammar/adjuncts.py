"""Parser of what may follow a verb and its object: orders, counts, conditions, objects to avoid."""

from __future__ import annotations

import itertools

from edge.mission.language.grammar.clause_parts import (
    CONDITIONS,
    ORDERS,
    Clause,
    Count,
    skip_particles,
    take_count,
    take_mood,
)
from edge.mission.language.grammar.conditions import another_participle, take_condition
from edge.mission.language.grammar.routes import (
    PASSING,
    add_to_route,
    is_destination_ahead,
    take_bound,
    take_route,
)
from edge.mission.language.words.naming import refuse_missing_name
from edge.mission.language.words.noun_phrases import (
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import Token, TokenReader


def take_adjunct(reader: TokenReader, memory: Antecedents, clause: Clause) -> bool:
    """Parse one more part of the clause; return False at its end."""
    token, start = reader.peek(), reader.at
    every = clause.targets is not None and clause.targets.every != ""  # "visit each place once"
    if token.kind == "always":
        clause.always = token  # "never go to a, at any moment"
        reader.at += 1
    elif token.kind == "in the end":
        clause.ends = True  # "visit a last"
        reader.at += 1
    elif token.text == "directly" and reader.is_at("after", "when", "once", ahead=1):
        clause.next_step = True
        reader.at += 1
    elif clause.negated and _is_by_way(reader):
        reader.refuse_finally("to exclude a path, say 'go to … without going through …'", token)
    elif token.text == "now" and clause.negated:
        reader.refuse_finally("say until when", token)
    elif token.kind in ("filler", "happen") or (token.kind == "forever" and clause.negated):
        reader.at += 1
    elif take_route(reader, memory, clause):
        pass
    elif token.kind == "on the way":
        clause.enroute = not (clause.avoiding or clause.route)
        reader.at += 1
    elif token.kind == "bound there":
        clause.enroute = clause.enroute or not clause.negated
        reader.at += 1
    elif token.kind == "comma" and reader.is_at("always", ahead=1) and _ends_sentence(reader, 2):
        reader.at += 1  # "keep away from it, always"
    elif token.kind in ("whichever", "comma") and _take_whichever(reader):
        pass
    elif token.kind == "either" and clause.negated and _ends_sentence(reader, 1):
        reader.at += 1  # "do not visit b either"
    elif token.text in ("though", "however") and _ends_sentence(reader, 1):
        reader.at += 1
    elif clause.targets and is_destination_ahead(reader, clause):
        take_bound(reader, memory, clause)
    elif token.kind in ORDERS:
        several = clause.targets and len(clause.targets.groups) > 1
        clause.order = token.kind if several or token.text != "in turn" else clause.order
        reader.at += 1
    elif token.kind == "comma" and reader.is_at(*ORDERS, ahead=1):
        reader.at += 1
    elif (count := take_count(reader, clause.negated, every)) is not None:
        clause.count = intersect_counts(reader, clause.count, count, token)
        several = clause.targets is not None and len(clause.targets.groups) > 1
        if several and reader.tokens[reader.at - 1].text.endswith(("in total", "overall")):
            reader.refuse_finally("unclear: this number for each, or for all together?", token)
    elif token.kind == "first" and not (
        reader.is_at("verb", ahead=1) or starts_noun_phrase(reader, 1)
    ):
        clause.first = True
        reader.at += 1
    elif token.kind == "again":
        clause.again = True  # "do not go to a any more"
        reader.at += 1
    elif token.kind == "immediately":
        clause.next_step = True
        clause.instant = token if token.text.startswith(("in ", "at ")) else clause.instant
        reader.at += 1
    elif token.kind == "banned":
        clause.negated = not clause.negated  # "visiting a is forbidden"
        clause.count = clause.count and _negate_count(reader, clause.count, token)
        reader.at += 1
    elif token.kind == "after" and reader.is_at("comma", "stop", "end", "and", ahead=1):
        clause.trails = True  # "visit a, and b after"
        reader.at += 1
    elif token.kind in ("but", "comma", "all of") and _take_separate_count(reader, clause):
        pass
    elif token.kind == "no return":
        clause.each = 1  # "visit a, b and c, no revisiting"
        reader.at += 1
    elif token.kind == "out of turn" and clause.negated:
        clause.out_of_turn = True  # "do not visit any place out of order"
        reader.at += 1
    elif token.kind == "then" and _ends_with_after_that(reader):
        clause.trails = True
        reader.at += 1
    elif token.kind in ("while", "without") or (token.kind == "avoid" and "ing" in token.text):
        take_avoiding(reader, memory, clause)
    elif token.kind == "comma" and _take_avoiding_aside(reader, memory, clause):
        pass
    elif _skip_to_condition(reader, clause):
        begin = reader.at
        condition = take_condition(reader, memory, clause)
        joined = any(skipped.kind == "and" for skipped in reader.tokens[start:begin])
        if joined and reader.is_at("verb", "you", "comma", "word", "article"):
            reader.at = start
            return False  # "…, and only if you see b, go to c"
        when = condition.kind == "when" and not condition.only
        if when and reader.peek().text == "then":
            reader.at = begin
            return False  # "visit a if you saw b then visit c": of the next clause
        after = condition.kind == "after" and clause.negated
        if (when or after) and reader.is_at("verb", "ensure", "you", "avoid"):
            hint = "unclear which part this belongs to; add a comma"
            reader.refuse_finally(hint, condition.token)
        clause.conditions.append(condition)
    else:
        return False
    return True


def _is_by_way(reader: TokenReader) -> bool:
    """Return True if "through a" or "except through a" comes, which may belong to a ban or not."""
    ahead = 1 if reader.peek().text in ("except", "but") else 0
    token = reader.peek(ahead)
    passes = token.kind == "via" or token.text in PASSING
    return passes and starts_noun_phrase(reader, ahead + 1)


def _ends_sentence(reader: TokenReader, ahead: int) -> bool:
    return reader.is_at("comma", "stop", "end", ahead=ahead)


def _take_whichever(reader: TokenReader) -> bool:
    """Skip ", whichever you like" after a choice; return False if it does not come."""
    ahead = 1 if reader.is_at("comma") else 0
    choice = any(token.kind in ("or", "either") for token in reader.tokens[: reader.at])
    whichever = reader.is_at("whichever", ahead=ahead) and _ends_sentence(reader, ahead + 1)
    if not (choice and whichever):
        return False
    reader.at += ahead + 1
    return True


def _negate_count(reader: TokenReader, count: Count, token: Token) -> Count:
    """Return the count of a clause that is forbidden: "visiting a more than once is prohibited"."""
    if count.least == count.most:  # "more or less than once"
        return count
    rest = count.negated()
    if rest is None:
        reader.refuse("say how often it may be instead", token)
    return rest


def _take_separate_count(reader: TokenReader, clause: Clause) -> bool:
    """Parse "but at most twice"; return False if it does not come."""
    begin, token = reader.at, reader.peek()
    reader.skip("but", "comma")
    reader.take("all of")
    count = take_count(reader, clause.negated)
    if count is None:
        reader.at = begin
        return False
    if clause.negated and clause.count:
        reader.refuse_finally("say the counts in two sentences", token)
    clause.count = intersect_counts(reader, clause.count, count, token)
    clause.separate_count = token.kind == "comma"
    return True


def intersect_counts(reader: TokenReader, old: Count | None, new: Count, token: Token) -> Count:
    """Return the intersection of two counts."""
    if old is None:
        return new
    most = min((m for m in (old.most, new.most) if m is not None), default=None)
    least = max(old.least, new.least)
    if most is not None and least > most:
        reader.refuse("the counts contradict each other", token)
    return Count(least, most)


def _ends_with_after_that(reader: TokenReader) -> bool:
    """Return True if "after that" ends this clause instead of beginning the next one."""
    if reader.peek().text in ("then", "and then", "followed by", "finally", "and finally"):
        return False
    if reader.is_at("filler", ahead=1):
        return _ends_sentence(reader, 2)
    if reader.is_at("can", "must", ahead=1) and reader.is_at("you", ahead=2):
        return _ends_sentence(reader, 3)  # "… after that, would you?"
    return reader.is_at("comma", "and", "but", "stop", "end", "then", ahead=1)


def _skip_to_condition(reader: TokenReader, clause: Clause) -> bool:
    """Skip to a condition of this clause, also after "but", "only" or "not".

    Return False if none comes.
    """
    ahead = 1 if reader.is_at("comma") else 0
    ahead += reader.is_at("but", "and", ahead=ahead)
    limited = reader.is_at("only", "not", ahead=ahead)
    if not reader.is_at(*CONDITIONS, ahead=ahead + limited):
        return False
    if ahead and not limited:
        return False  # ", and before that …" begins the next clause
    that = reader.is_at("before", "after", "until") and reader.is_at("pronoun", ahead=1)
    goes_on = that and reader.is_at("verb", "you", "ensure", "must", ahead=2)
    if goes_on and clause.conditions and not limited:
        return False  # "before that visit b" belongs to the next clause
    reader.at += ahead
    return True


def _take_avoiding_aside(reader: TokenReader, memory: Antecedents, clause: Clause) -> bool:
    """Parse ", avoiding x," before ", then y"; return False, and take nothing, for anything else.

    At the end of a sentence it may belong to all clauses before it.
    """
    avoid = reader.peek(1)
    if avoid.kind != "avoid" or not avoid.text.endswith("ing") or not clause.targets:
        return False
    begin, inner = reader.at, Clause(avoid)
    reader.at += 1
    take_avoiding(reader, memory, inner)
    if clause.negated or not reader.is_at("then", ahead=1 if reader.is_at("comma") else 0):
        reader.at = begin
        return False
    clause.avoiding += inner.avoiding
    return True


# Words after an avoidance that make it permanent.
_EVER = ("ever", "at any point", "at any time", "at any point in time", "at all")


def take_avoiding(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse `while avoiding x`, `without visiting x`, `while not going to x` and the like."""
    token = reader.take("while", "without", "avoid")
    assert token is not None
    denied = token.kind != "while"
    inner = Clause(reader.peek())
    begin = reader.at
    take_mood(reader, inner)
    if any(done.text in ("have", "has") for done in reader.tokens[begin : reader.at]):
        reader.refuse("say 'do not visit … before …'", token)
    avoid = reader.take("avoid")
    denied = denied or inner.negated or avoid is not None
    skips = avoid is not None and avoid.text == "skipping"
    if skips and reader.is_at("or") and reader.is_at("verb", ahead=1):
        reader.at += 1
    while verb := reader.take("verb"):
        inner.verb = verb.text
        inner.again = inner.again or verb.text.startswith(("revisit", "return"))
        skip_particles(reader, inner)
    if inner.again and not starts_noun_phrase(reader):  # "without going back"
        clause.each = 1
        return
    if not starts_noun_phrase(reader):
        refuse_missing_name(reader)
    if token.kind == "without" and reader.peek().text in ("both", "both of"):
        hint = "unclear: none of them, or not both? say for each if to avoid it"
        reader.refuse_finally(hint)
    if token.text == "with no" and not inner.verb:
        reader.refuse_finally("say 'without …'", token)  # "the room with no window"
    targets = take_noun_phrase(reader, memory, banned=not clause.negated, way=True)
    kinds = [t.kind for t in reader.tokens[begin : reader.at]]
    if len(targets.groups) == 2 and ("comma", "and") in itertools.pairwise(kinds):
        reader.refuse_finally("unclear if this is to be avoided too; use two sentences", token)
    while denied and reader.is_at("or", "and") and another_participle(reader):
        skip_particles(reader, inner)
        more = take_noun_phrase(reader, memory, banned=True)
        targets = NounPhrase(targets.groups + more.groups)  # "without entering a or touching b"
    if denied and not targets.every and take_count(reader, negated=False) is not None:
        reader.refuse_finally("unclear how often; use a separate sentence", token)
    if (reader.take("first") or inner.first) and not clause.negated:
        if denied:  # "go to a without visiting b first"
            clause.not_first.append(targets)
        elif clause.targets is None:
            reader.refuse_finally("say 'first …, then …'", token)
        else:
            add_to_route(reader, clause, targets, token)  # "go to a while visiting b first"
        return
    if not denied and targets.every:
        count = take_count(reader, negated=False)
        if count is None:
            reader.refuse("say 'at most … times'", token)
        clause.each = count.most or count.least  # "while only visiting each place once"
        return
    if not denied:
        reader.refuse("only 'while avoiding …' is possible; say what to visit first", token)
    if targets.every and (skips or inner.again):
        clause.order = "strict order" if skips else clause.order
        clause.each = 1 if inner.again else clause.each
        return
    if targets.every == "places":
        reader.refuse("say what to avoid", token)
    if reader.peek().text in _EVER:
        reader.at += 1
    ever = any(t.text in _EVER for t in reader.tokens[begin : reader.at])
    ever = ever or token.text == "without ever"
    if (inner.always or ever) and not inner.again:
        clause.never.append(targets)
    elif inner.again or reader.take("again"):
        clause.not_again.append(targets)
    else:
        clause.avoiding.append(targets)
        clause.during = clause.during or token.kind == "while"
