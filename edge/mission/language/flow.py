"""How a clause goes on from the one before it: beside it, after it, or on the way to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge.mission.language.meaning import Meaning
from edge.mission.language.routes import PASSING
from edge.mission.language.spoken import Clause
from edge.mission.language.words import Reader, Token

THEN = ("then", "only then")
JOINTS = ("comma", "and", "but", *THEN)
"""What stands between clauses; the last of several said most about how they go together."""

_MOVES = (
    "go", "move", "walk", "drive", "head", "travel", "come", "proceed", "enter", "continue", "pass",
    "navigate", "cross", "fly", "climb", "follow", "traverse", "return",
)  # fmt: skip
_WAYS = ("take the ", "use the ", "take a ", "use a ", "follow the ", "choose the ")
_ARRIVES = ("arrive", "reach", "get")
ENDING = ("conclude ", "end ", "ends ", "ending ", "finish")
_ENDING = (*ENDING, "your ", "the ")
_ONWARD = ("proceed", "continue", "keep ", "go on", "carry on", *_ENDING)
_ALSO = ("also", "too", "as well", "at some point")


@dataclass(slots=True)
class Flow:
    """What the last clause did, as far as the next one's place depends on it.

    Attributes:
        moved: it was a plain order to go somewhere: "go to a go to b" is in order.
        passed: it only went through somewhere.
        verb: what named its action.
    """

    moved: bool = False
    passed: bool = False
    verb: str = ""

    def comes_after(
        self,
        clause: Clause,
        joint: Token | None,
        sequence: Sequence[Meaning],
        asked: bool,
        reader: Reader,
    ) -> bool:
        """Whether a clause comes after all before it; else it may be said to lie on the way there.

        Args:
            joint: what stands before it; None at the start of a sentence.
            sequence: the steps of its sentence so far.
            asked: sentences before asked for something.
        """
        kind = joint.kind if joint else None
        also = clause.token.text in _ALSO
        ensures = clause.token.kind == "ensure"
        moves = _moves(clause)
        onward = clause.verb.startswith(_ONWARD) and not clause.negated
        bare = clause.verb == "" and not clause.negated
        reaches = moves or bare or (clause.verb.startswith(_ARRIVES) and not clause.negated)
        after = any(
            (
                clause.trails,
                kind in THEN,
                clause.returns and (sequence or asked) and not clause.negated,
                onward and sequence and not sequence[-1].loose,
                onward and asked and clause.verb.startswith(_ENDING),
                moves and self.moved and kind == "" and not ensures,
                reaches and self.passed and joint and not also,
                # "via b, go to a"
                self.passed and not self.verb and not clause.negated and kind in ("", "comma"),
            )
        )
        through = clause.through and not clause.route
        last = reader.sees("end") or reader.sees("end", ahead=1)
        beside = through and moves and not after and not self.passed
        if beside and not sequence and not also and last:
            clause.enroute = asked  # "go to a. Please go through b."
        elif beside and sequence and (ensures or kind == "but" or clause.by_way):
            clause.enroute = True  # "go to a, making sure to go through b"
        elif beside and sequence and self.moved:
            clause.enroute = reader.pick(clause.token, 2) == 0
        elif any(token.kind == "any order" for token in reader.tokens):
            pass
        elif moves and self.moved and not (after or also) and joint and kind == "and":
            after = reader.pick(joint, 2) == 1  # "go to a and go to b" may be in order
        on = bool(clause.things) and bare and self.passed  # "through a, then b, to c"
        self.moved, self.passed = moves, (through or on) and not clause.negated
        self.verb = clause.verb
        return after


def _moves(clause: Clause) -> bool:
    """Whether it is a plain order to go somewhere."""
    rides = clause.verb.startswith(_WAYS) and clause.verb.endswith(PASSING)
    more = clause.only or clause.count or clause.conditions or clause.enroute or clause.first
    return (rides or clause.verb in _MOVES) and not (clause.negated or more)
