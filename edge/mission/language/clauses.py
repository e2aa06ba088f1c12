"""One clause of an instruction: who must (not) do what, how often, under which conditions.

clause    = { condition [","] } { mood } ( action | passive | bare ) { adjunct }
action    = verb { verb } particles things | avoid [verb] things
passive   = things { mood } ( verb | avoid | "happen" )
bare      = things                       (after another clause: ", then a tv")
adjunct   = order | count | condition | "while avoiding" things | "without" [verb] things
condition = ("before" | "after" | "until" | "unless" | "when" | "once") happening
happening = ["you" mood] verb things | things [mood (verb | "happen")] | pronoun
"""

from __future__ import annotations

from typing import Literal

from edge.mission.language import nouns
from edge.mission.language.adjuncts import (
    lead,
    narrower,
    take_adjunct,
    take_avoiding,
    take_condition,
)
from edge.mission.language.spoken import (
    AUXILIARIES,
    CONDITIONS,
    MOOD,
    ORDERS,
    PREDICATE,
    Clause,
    Condition,
    Memory,
    skip_particles,
    take_count,
    take_mood,
)
from edge.mission.language.things import (
    Things,
    is_indefinite,
    starts_things,
    take_things,
)
from edge.mission.language.words import Reader

Bare = Literal["yes", "known", "no"]
_MOTION = ("go", "come", "walk", "move", "head", "run", "drive", "travel", "return", "proceed")
_PERFORM = ("make", "complete", "perform", "have")


def starts_clause(reader: Reader, ahead: int = 0) -> bool:
    """Whether a clause can begin at that token."""
    if reader.sees("to", ahead=ahead):
        ahead += 1
    return starts_things(reader, ahead) or reader.sees(
        *MOOD, *CONDITIONS, *ORDERS, "verb", "avoid", "immediately", "banned", ahead=ahead
    )


def take_clause(reader: Reader, memory: Memory, bare: Bare) -> Clause:
    """The clause that begins here.

    Args:
        bare: whether it may do without a verb: always, if it names known things, or never.

    Raises:
        TranslationError: it is none.
    """
    clause = Clause(reader.peek())
    _take_opening(reader, memory, clause)
    take_mood(reader, clause)
    if reader.peek().text in _PERFORM and _counts(reader, 1):
        reader.at += 1
    count_at = reader.peek()
    if (count := take_count(reader, clause.negated)) is not None:  # "at least two visits to a"
        clause.count = narrower(reader, clause.count, count, count_at)
        reader.skip("to")
        clause.things = take_things(reader, memory.named)
    elif reader.sees("verb", "avoid"):
        _take_action(reader, memory, clause)
    elif starts_things(reader):
        _take_passive(reader, memory, clause, bare)
    elif reader.sees("to") and starts_things(reader, 1) and (bare == "yes" or clause.negated):
        reader.take("to")
        clause.things = take_things(reader, memory.named, banned=clause.negated)
    else:
        reader.refuse("expected something to do or to avoid here")
    if clause.things:
        memory.named = clause.things
        if not clause.negated and clause.mood != "can":
            memory.asked = clause.things
    asked = memory.asked
    if clause.bound:
        lead(reader, memory, clause, clause.bound, clause.token)
    while take_adjunct(reader, memory, clause):
        pass
    if clause.negated and clause.first and not clause.conditions and not clause.count:
        if asked is None:
            reader.refuse("say before what it is not to be reached", clause.token)
        clause.conditions.append(Condition("before", clause.token, asked))  # "not b first"
        clause.first = False
    return clause


def _take_opening(reader: Reader, memory: Memory, clause: Clause) -> None:
    """Passes what may stand before a clause: an order, conditions."""
    while True:
        token = reader.peek()
        ahead = 1 if reader.sees("only", "immediately", "filler") else 0
        if token.kind in ORDERS:
            clause.order = token.kind
            reader.at += 1
        elif token.kind == "while" and not clause.conditions:
            take_avoiding(reader, memory, clause)
        elif token.kind == "bound" or (
            token.kind == "to" and reader.sees("verb", ahead=1) and not clause.bound
        ):
            reader.at += 1
            while reader.take("verb"):
                skip_particles(reader, clause)
            clause.bound = take_things(reader, memory.named)
        elif reader.sees(*CONDITIONS, ahead=ahead):
            if token.kind in ("immediately", "filler"):
                clause.next_step = clause.next_step or token.kind == "immediately"
                reader.at += 1
            condition = take_condition(reader, memory, clause)
            clause.conditions.append(condition)
            memory.named = condition.things
        else:
            return
        reader.skip("comma")
        if clause.conditions and reader.peek().text == "then":
            reader.at += 1  # "if …, then …"


def _counts(reader: Reader, ahead: int) -> bool:
    return reader.sees("number", "at least", "at most", "exactly", "only", ahead=ahead)


def _take_action(reader: Reader, memory: Memory, clause: Clause) -> None:
    if avoid := reader.take("avoid"):
        clause.negated = not clause.negated
        clause.verb = avoid.text
        take_mood(reader, Clause(avoid))
    while token := reader.take("verb"):
        if clause.verb.startswith("stop") and token.text.endswith("ing"):
            clause.negated = not clause.negated  # "stop visiting it"
        clause.verb = token.text
        clause.again = clause.again or token.text.startswith("revisit")
        clause.returns = clause.returns or token.text.startswith("return")
        skip_particles(reader, clause)
    if reader.take("neither"):
        clause.negated = True
    elif reader.tokens[reader.at - 1].text in _MOTION and not _plainly_named(reader):
        reader.refuse("no thing that is known; if it is one, say 'to the …'")
    through = reader.tokens[reader.at - 1].text in _THROUGH
    last = reader.tokens[reader.at - 1]
    from_first = last.text == "from"
    if starts_things(reader):
        clause.through = through or clause.verb.startswith("cross")
        clause.things = take_things(reader, memory.named, banned=clause.negated, way=clause.through)
        _take_more_bans(reader, memory, clause)
        while (from_first or _onward(reader, clause, through)) and _take_onward(reader):
            # "travel from a to b to c", "go through a and into b", "go to a or b, to c"
            further = take_things(reader, memory.named)
            if clause.negated:  # "do not go through a to b"
                lead(reader, memory, clause, further, last)
            elif from_first and reader.pick(last, 2) == 0:  # where the robot is
                clause.things = further
            else:
                clause.things = Things(clause.things.groups + further.groups)
                clause.order = "in order"
    elif not clause.negated or not clause.verb.startswith("stop"):
        reader.refuse("expected the name of a thing here", reader.peek())


_THROUGH = ("through", "past", "by", "via", "continue through")


def _onward(reader: Reader, clause: Clause, through: bool) -> bool:
    """Whether "to b" may go on from there."""
    onto = reader.peek(1 if reader.sees("and") else 0).text in ("into", "onto", "in to")
    moved = clause.verb in _MOTION and reader.sees("to")
    return through or (not clause.negated and (onto or moved))


def _take_onward(reader: Reader) -> bool:
    """Passes "to", "and into" before a thing; False, and nothing taken, when there is none."""
    ahead = 1 if reader.sees("and") else 0
    if reader.peek(ahead).text == "through":
        return False
    if not reader.sees("to", ahead=ahead) or not starts_things(reader, ahead + 1):
        return False
    reader.at += ahead + 1
    return True


def _take_more_bans(reader: Reader, memory: Memory, clause: Clause) -> None:
    """`do not visit a or touch b or revisit c`: "not" goes with each verb."""
    while clause.negated and reader.sees("or") and reader.sees("verb", ahead=1):
        reader.take("or")
        again = False
        while verb := reader.take("verb"):
            again = again or verb.text.startswith(("revisit", "return"))
            skip_particles(reader, clause)
        things = take_things(reader, memory.named, banned=True)
        if again:
            clause.not_again.append(things)
        elif clause.things is not None:
            clause.things = Things(clause.things.groups + things.groups)


def _take_passive(reader: Reader, memory: Memory, clause: Clause, bare: Bare) -> None:
    """`a and b must be visited`; or just names."""
    start = reader.peek()
    begin = reader.at
    things = take_things(reader, memory.named, subject=True, banned=clause.negated)
    says = Clause(start)
    said = take_mood(reader, says, PREDICATE)
    if reader.sees("do") and reader.sees("not", ahead=1) and reader.sees("happen", ahead=2):
        reader.at += 2
        says.negated = True
    avoid = reader.take("avoid")
    verb = avoid or reader.take("verb", "happen")
    if verb is not None and (said & AUXILIARIES or verb.kind == "happen"):
        clause.mood = says.mood if says.mood != "do" else clause.mood
        clause.negated = clause.negated != (says.negated != bool(avoid))
        clause.only, clause.first = clause.only or says.only, clause.first or says.first
        clause.verb = verb.text
        clause.things = _each(things) if clause.negated else things
        return
    reader.at = begin
    named = start.kind != "word" or is_indefinite(reader) or _well_known(reader, memory)
    if not (named and (bare == "yes" or clause.negated)) and not (
        bare == "known" and _well_known(reader, memory)
    ):
        reader.refuse("no verb that is known", start)
    clause.things = take_things(reader, memory.named, banned=clause.negated)


def _well_known(reader: Reader, memory: Memory) -> bool:
    """Whether the names that follow can be nothing but names, so that they need no verb."""
    begin = reader.at
    things = take_things(reader, memory.named)
    reader.at = begin
    return all(len(name) == 1 or nouns.is_noun(_unnumbered(name)) for name in things.names)


def _unnumbered(name: str) -> str:
    """`room three` is as well known as a room is."""
    kind, _, number = name.rpartition(" ")
    return kind if number in nouns.CARDINALS else name


def _plainly_named(reader: Reader) -> bool:
    """Whether what follows is no unknown word without an article ("upstairs")."""
    token = reader.peek()
    return token.kind != "word" or len(token.text) == 1 or nouns.is_noun(token.text)


def _each(things: Things) -> Things:
    return Things(tuple((name,) for name in things.names))
