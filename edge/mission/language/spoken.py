"""The parts of a clause as they were said, and the words of obligation before its verb."""

from __future__ import annotations

from dataclasses import dataclass, field

from edge.mission.language.counts import Count
from edge.mission.language.lexicon import AFTER_VERB
from edge.mission.language.things import Things
from edge.mission.language.words import Reader, Token

CONDITIONS = ("before", "after", "until", "unless", "when", "once")
ORDERS = ("any order", "in order", "strict order")
MOOD = ("you", "ensure", "must", "can", "do", "not", "filler", "only", "first", "be")
AUXILIARIES = frozenset({"be", "must", "can"})
PREDICATE = ("must", "can", "not", "filler", "only", "first", "be")


@dataclass(slots=True)
class Condition:
    """When a clause counts.

    Attributes:
        kind: "before", "after", "until", "unless" or "when" ("once" is "when").
        token: where it begins.
        only: "only after …".
        denied: "not before …", or a happening that is itself denied.
        recurring: "whenever", "if": each time, not once.
        count: how often the happening must have been.
    """

    kind: str
    token: Token
    things: Things
    only: bool = False
    denied: bool = False
    recurring: bool = False
    count: Count | None = None


@dataclass(slots=True)
class Clause:
    """What one clause says.

    Attributes:
        token: where it begins.
        mood: "do" (an order), "must" (a duty) or "can" (a permission).
        negated: "do not", "never", "avoid".
        only: "only" before the verb.
        things: what it is about; None for "do not stop (until …)".
        avoiding: things to be avoided on the way ("while avoiding", "without").
        not_again: things not to be visited once more on the way ("without returning to x").
        next_step: "right after", "immediately".
        again: "again", "any more", "revisit".
        first: said to come first.
        trails: said to come after the clause before it ("… after that").
        verb: the word that named the action, "" in a bare clause.
    """

    token: Token
    mood: str = "do"
    negated: bool = False
    only: bool = False
    things: Things | None = None
    conditions: list[Condition] = field(default_factory=list)
    avoiding: list[Things] = field(default_factory=list)
    not_again: list[Things] = field(default_factory=list)
    order: str = ""
    count: Count | None = None
    next_step: bool = False
    again: bool = False
    first: bool = False
    trails: bool = False
    verb: str = ""


@dataclass(slots=True)
class Memory:
    """What pronouns stand for: the last thing named, and the last one asked for."""

    named: Things | None = None
    asked: Things | None = None


def take_mood(reader: Reader, clause: Clause, kinds: tuple[str, ...] = MOOD) -> set[str]:
    """Passes "you must never", "please make sure to", and so on; which kinds there were."""
    seen: set[str] = set()
    while True:
        token = reader.peek()
        if token.kind == "to" and reader.sees("verb", "not", "avoid", "be", "happen", ahead=1):
            reader.at += 1
            continue
        if (
            token.kind == "all of" and seen and reader.sees("verb", "be", ahead=1)
        ):  # "are both visited"
            reader.at += 1
            continue
        if token.kind == "only" and reader.sees(*CONDITIONS, ahead=1):
            return seen
        if token.kind == "banned":
            clause.negated = not clause.negated
            reader.at += 1
            continue
        if token.kind not in kinds:
            return seen
        seen.add(token.kind)
        reader.at += 1
        if token.kind in ("first", "filler"):
            reader.skip("comma")
        if token.kind == "not":
            clause.negated = not clause.negated
        elif token.kind == "only":
            clause.only = True
        elif token.kind == "first":
            clause.first = True
        elif token.kind in ("must", "can"):
            clause.mood = token.kind
            if token.kind == "can" and reader.take("you"):  # "can you go to …": a request
                clause.mood = "do"


def skip_particles(reader: Reader, clause: Clause) -> None:
    """Passes what stands between a verb and its object: "go first directly to"."""
    while True:
        token = reader.peek()
        if token.text in AFTER_VERB and token.kind in ("word", "place", "to"):
            reader.at += 1
        elif token.kind == "first":
            clause.first = True
            reader.at += 1
        elif token.kind in ("to", "filler") or (
            token.kind == "and" and reader.sees("verb", ahead=1) and clause.verb == "go"
        ):
            reader.at += 1
        elif token.kind == "again" or token.text == "back":
            clause.again = True
            reader.at += 1
        else:
            return
