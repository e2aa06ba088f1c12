"""Parser of the action of a clause: its verb, the objects it passes, and the objects it reaches."""

from __future__ import annotations

from edge.mission.language.grammar.clause_parts import Clause, Condition, skip_particles, take_mood
from edge.mission.language.grammar.conditions import take_happening
from edge.mission.language.grammar.routes import (
    PASSING,
    add_to_route,
    set_destination,
    take_exception,
)
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import AVOIDING
from edge.mission.language.words.naming import refuse_missing_name
from edge.mission.language.words.noun_phrases import (
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import NONE_OR_NOT_ALL, REASONS, Token, TokenReader

UP = ("up", "down", "over", "on")
"""Particles after "back" that say nothing about the goal: "back up to the roof"."""
_MOTION = ("go", "come", "walk", "move", "head", "run", "drive", "travel", "return", "proceed")
# Beginnings of verbs that carry an object to another one.
_CARRIES = ("bring", "fetch", "take", "put", "carry", "grab", "collect", "load", "pick", "get ")
_INTO = ("into", "onto", "in to")
# Verbs that mean leaving or going along before "off", "out" or "with".
_LEAVES = (*_MOTION, "get", "step", "climb", "fly", "roll", "navigate", "move", "pass")
_PASSES = ("cross", "follow", "traverse", "pass")  # beginnings of verbs whose object is passed
_STREETS = ("road", "street", "lane")
_ALONG = ("path", "route", "road", "way", *PASSING)  # ends of verbs with a path to follow
_GOES_ON = ("proceed", "continue")  # beginnings of verbs that another verb may follow
# Beginnings of verbs after which a place is passed: "take the stairs to a".
_RIDES = ("take", "use", "ride", "climb", "go", "pass", "follow")
_ANYWHERE = ("go anywhere", "visit anywhere")
# First words of verbs for a manner of going, which a ban cannot forbid.
_MANNERS = [  # each in a list, as `split` returns it
    [verb] for verb in ("rush", "hurry", "race", "run", "running", "rushing", "zoom", "turn")
]
_ALL_OF = ("both", "both of", "all of", "all", "every")


def is_passing(reader: TokenReader, ahead: int = 0, any_way: bool = False) -> bool:
    """Return True if a path without a verb comes: ", then past the sofa".

    `any_way` also accepts the particle without an object.
    """
    token = reader.peek(ahead)
    if token.text == "back":
        return reader.is_at("to", ahead=ahead + 1) or reader.peek(ahead + 1).text in UP
    passes = token.kind == "via" or token.text in PASSING
    return passes and (any_way or starts_noun_phrase(reader, ahead + 1))


def goes_on_to(reader: TokenReader) -> bool:
    """Return True if "go on the third floor" comes, but not "go on until"."""
    return reader.peek().text == "go on" and starts_noun_phrase(reader, 1)


def take_action(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse a verb and its objects: `go to a`, `avoid a`, `go through a to b`, `do not skip a`.

    Raises:
        TranslationError: no object of the verb follows.
    """
    was_negated = False
    if clause.negated and reader.is_at("avoid") and "anywhere" in reader.peek().text:
        # "don't go anywhere but to a"
        reader.refuse_finally("say what to visit, and what to avoid")
    if avoid := reader.take("avoid"):
        was_negated = clause.negated  # "do not skip a or b"
        clause.negated = not clause.negated
        clause.verb = avoid.text
        if reader.is_at("you"):  # "go anywhere but you finish at the bed"
            reader.refuse("use two sentences", avoid)
        inner = Clause(avoid)
        take_mood(reader, inner)
        if inner.negated:
            reader.refuse_finally("say it without 'not'", avoid)
    if goes_on_to(reader):
        clause.verb = "go"
        reader.at += 1
    while token := reader.take("verb"):
        if clause.verb.startswith("stop") and token.text.endswith("ing"):
            clause.negated = not clause.negated  # "stop visiting it"
        if not clause.verb.startswith(_GOES_ON) or token.text.startswith(_PASSES):
            clause.verb = token.text  # "proceed to clean it" goes on
        clause.again = clause.again or token.text.startswith("revisit")
        clause.returns = clause.returns or token.text.startswith("return")
        skip_particles(reader, clause)
    if reader.is_at("in order", "strict order") and reader.peek(1).text == ":":
        clause.order = reader.peek().kind  # "visit in this order: a, b, c"
        reader.at += 2
    if reader.take("neither"):
        clause.negated = True
    elif reader.tokens[reader.at - 1].text in _MOTION and not _is_plain_name(reader):
        reader.refuse("not a known object; if it is one, say 'to the …'")
    last = reader.tokens[reader.at - 1]
    warns = clause.verb in ("watch", "look") and reader.tokens[reader.at - 2].text == "out"
    if warns or clause.verb == "starts":  # "watch out for a", "the robot starts in a"
        reader.refuse("the robot can only go to objects", last)
    if last.text in ("off", "out", "with") and clause.verb in _LEAVES:
        reader.refuse("the robot can only go to objects", last)
    passes = last.text.split(" ")[-1] in PASSING or clause.verb.startswith(_PASSES)
    if clause.negated and clause.verb.split()[:1] in _MANNERS and not passes:
        reader.refuse_finally("how to go cannot be chosen; say only where to go", last)
    if reader.is_at("only") and is_passing(reader, 1, any_way=True):
        reader.at += 2  # "go only through a"
        clause.only = passes = True
    elif reader.take("via"):
        passes = clause.by_way = True
    if (other := take_exception(reader, memory)) is not None:
        if clause.negated:
            reader.refuse_finally("say what to avoid", last)
        clause.targets, clause.negated, clause.elsewhere = other, True, True
        clause.through, clause.only = passes, False
        token = reader.peek()
        if passes and _take_onward(reader):  # "go through any room but a to b"
            set_destination(reader, memory, clause, take_noun_phrase(reader, memory), token)
    elif starts_noun_phrase(reader):
        take_passed(reader, memory, clause, passes, last)
        if was_negated and clause.targets:
            clause.targets = each_of(clause.targets)
        if clause.negated and reader.is_at("or") and reader.is_at("verb", ahead=1):
            reader.refuse_finally("unclear what is forbidden; use a separate sentence")
    elif clause.returns and memory.asked and clause.negated:
        clause.targets = memory.asked  # "never go back"
    elif not clause.negated or not clause.verb.startswith("stop"):
        refuse_missing_name(reader)
    if clause.verb.startswith(_ANYWHERE) and not clause.verb.endswith("near"):
        clause.elsewhere = clause.mood != "can"


def take_passed(
    reader: TokenReader,
    memory: Antecedents,
    clause: Clause,
    passes: bool = True,
    verb: Token | None = None,
) -> None:
    """Parse objects and the objects after them: "through a and into b", "from a to b to c"."""
    if clause.negated and clause.verb not in AVOIDING and reader.peek().text in _ALL_OF:
        reader.refuse_finally(NONE_OR_NOT_ALL)
    if clause.negated and verb and verb.text == "from":
        reader.refuse_finally("unclear which one to avoid; say 'avoid …'", verb)
    targets = take_noun_phrase(reader, memory, banned=clause.negated, way=passes)
    carries = clause.negated and clause.verb.startswith((*_CARRIES, "move"))
    if carries and reader.is_at("to") and starts_noun_phrase(reader, 1):
        reader.refuse_finally("the robot can only go to objects", verb)
    rides = clause.verb.startswith(_RIDES) and all(map(nouns.is_place, targets.names))
    clause.targets, clause.through = targets, passes or (rides and clause.verb[:2] != "go")
    if clause.verb.startswith("follow") and not rides and not clause.verb.endswith(_ALONG):
        reader.refuse("the robot can only follow a path", verb)
    across = verb is not None and verb.text == "across" and reader.is_at("to")
    if across and targets.names[-1].split()[-1] in _STREETS:
        reader.refuse_finally("'across …' is unclear; say only where to go, or 'through …'", verb)
    if verb and verb.text == "from":
        reader.refuse_finally(REASONS["origin"], verb)
    while _may_go_onward(reader, clause):
        token = reader.peek()
        if not _take_onward(reader):
            break
        further = take_noun_phrase(reader, memory)
        if clause.verb == "pass" and nouns.PEOPLE.intersection(further.names):
            # "pass the cup to the guest"
            reader.refuse_finally("the robot can only go to objects", token)
        if clause.route and len(clause.targets.groups[-1]) > 1:
            reader.refuse("say it in two sentences: 'go through a to b, or through c to d'", token)
        if clause.negated:  # "do not go through a to b"
            set_destination(reader, memory, clause, further, token)
        else:
            add_to_route(reader, clause, clause.targets, token)
        clause.targets = further


def _may_go_onward(reader: TokenReader, clause: Clause) -> bool:
    """Return True if "to b" may follow here."""
    ahead = 1 if reader.is_at("and") else 0
    onto = reader.peek(ahead + (reader.peek(ahead).text == "out")).text in _INTO
    if not clause.through and (onto or reader.is_at("to")):
        _refuse_leading(reader, clause, ahead if onto else 0)
    moved = clause.verb in _MOTION and reader.is_at("to")
    return clause.through or (not clause.negated and (onto or moved))


LEADING = nouns.split_entries(
    """door doorway gate gateway entrance entry exit key path road street way stair stairs staircase
    ladder ramp bridge tunnel passage passageway hatch archway driveway"""
)
"""Objects that lead to a place: "the door to the kitchen" is one object."""
LEADS_ON = "unclear: one object that leads to the other, or both in turn? say 'then to …'"


def _refuse_leading(reader: TokenReader, clause: Clause, ahead: int) -> None:
    """Refuse `go to the door to the kitchen` and `move the cup to the table` as ambiguous."""
    before = reader.tokens[: reader.at]
    verb = max((i for i, token in enumerate(before) if token.text == clause.verb), default=0)
    moves = clause.verb in (*_MOTION, "get")
    moved = moves and before[verb + 1].kind in ("article", "word", "quoted")
    carried = moved or clause.verb.startswith(_CARRIES)
    if carried and not all(map(nouns.is_place, clause.targets.names)):
        reader.refuse_finally("the robot can only go to objects", reader.peek(ahead))
    if clause.targets.names[-1].split()[-1] in LEADING:
        reader.refuse_finally(LEADS_ON, before[verb])


def _take_onward(reader: TokenReader) -> bool:
    """Skip "to" or "and into" before an object; return False if it does not come."""
    ahead = 1 if reader.is_at("and") else 0
    ahead += reader.peek(ahead).text in ("out", "on")
    if reader.peek(ahead).text == "through":
        return False
    if not reader.is_at("to", ahead=ahead) or not starts_noun_phrase(reader, ahead + 1):
        return False
    reader.at += ahead + 1
    return True


def take_until(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse `keep going until you reach a`: the clause asks for a, after the clauses before it."""
    token = reader.take("onward")
    assert token is not None
    if clause.negated:
        reader.refuse("say it without 'not'", token)
    happening = Condition("until", token, NounPhrase(()))
    take_happening(reader, memory, happening)
    if happening.denied or happening.count:
        reader.refuse("say where to go", token)
    clause.verb, clause.targets = "continue", happening.targets


def _is_plain_name(reader: TokenReader) -> bool:
    """Return True unless an unknown word without an article follows ("upstairs")."""
    token = reader.peek()
    if token.kind != "word" or len(token.text) == 1 or token.text in PASSING:
        return True
    return nouns.is_noun(token.text) or token.text in nouns.QUALITIES


def each_of(targets: NounPhrase) -> NounPhrase:
    """Return the names as separate groups, so that each of them is meant."""
    return NounPhrase(tuple((name,) for name in targets.names))
