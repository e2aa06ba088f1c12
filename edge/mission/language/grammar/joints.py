"""Parser of the words between two clauses: "and then", "second", and where the robot stops."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from edge.mission.language.grammar.action import LEADING, LEADS_ON
from edge.mission.language.grammar.clauses import starts_clause
from edge.mission.language.grammar.flow import ENDING, JOINTS, Flow
from edge.mission.language.words import nouns
from edge.mission.language.words.tokens import Token, TokenReader


@dataclass(slots=True)
class Joints:
    """Parser of joints, with what they have said so far."""

    number: int = 1  # number of the last numbered step ("second, …"); 1 before any
    halted: Token | None = None  # token of the place where the robot must stop

    def take(self, reader: TokenReader, flow: Flow, started: bool) -> Token | None:
        """Skip the words that join this clause to the next; return None if the sequence ends."""
        if reader.is_at("comma") and reader.is_at("or", ahead=1):
            return None
        begin, joint = reader.at, reader.peek()
        while token := reader.take(*JOINTS):  # the strongest of several words is the joint
            if JOINTS.index(token.kind) >= JOINTS.index(joint.kind):
                joint = token
        last = reader.is_at("filler", "addressed") or (started and reader.is_at("any order"))
        if last and reader.is_at("stop", "end", ahead=1):
            reader.at += 1  # "…, please.", "…, but the order is up to you."
            return None
        if started and self.take_halt(reader, flow):
            return None
        if reader.at > begin:
            if joint.kind == "comma" and _is_participle_clause(reader):
                hint = "unclear: on the way, or in addition? say 'and then' or 'on the way'"
                reader.refuse_finally(hint)
            if not starts_clause(reader):
                reader.refuse("expected a clause here")
            return joint
        if reader.is_at("end", "stop", "or"):
            return None
        verb = reader.peek().text.split()[0] if reader.is_at("verb") else ""
        no_order = verb.endswith(("ing", "s")) and not verb.endswith("ss")  # "…, it goes to b"
        named = reader.is_at("word", "quoted", "to") and len(reader.peek().text) > 1  # no verb
        if not starts_clause(reader) or named or no_order:
            if reader.is_at("to") and reader.peek(-1).text in LEADING:
                reader.refuse_finally(LEADS_ON)
            reader.refuse("unknown word")
        return Token("", "", joint.start, joint.start)  # a joint without words

    def take_halt(self, reader: TokenReader, flow: Flow) -> bool:
        """Skip "and stay there" at the end: a mission ends where its last goal is reached.

        Return False if it does not come.
        """
        bare = reader.peek().text in ("stop", "halt")
        if not (bare or reader.is_at("halt")) or not reader.is_at("stop", "end", ahead=1):
            return False
        self.halted = reader.peek()
        if flow.denied or flow.permitted or not bare:
            reader.refuse("say where to stop, and what comes last", self.halted)
        reader.at += 1
        return True

    def check_number(self, reader: TokenReader, joint: Token | None, started: bool) -> None:
        """Check that a numbered step ("second", "third") comes in its turn, and note its number."""
        words = joint.text.split() if joint else []
        # The ordinal in the joint: 2 for "second". "Lastly" without earlier numbers is the last.
        number = next((i for i, word in enumerate(nouns.NUMERALS[:-1], 1) if word in words), None)
        if joint and self.number == 1 and not started and words[-1] in ("lastly", "finally"):
            number = len(nouns.NUMERALS)
        if number is None or joint is None:
            if self.number > 1 and reader.is_at("first", "opener"):
                reader.refuse_finally("give the steps in their order")
            return
        # "…, second chair": the second step, or the second chair?
        bare = reader.is_at("word") and len(reader.peek().text) > 1
        if number <= self.number or (bare and joint.text in nouns.ORDINALS):
            reader.refuse_finally("unclear which step this is; say 'then the …'", joint)
        self.number = number


def _is_participle_clause(reader: TokenReader) -> bool:
    """Return True if "visiting b" comes, which may mean on the way or in addition.

    "ending at b" is clear, so it does not count.
    """
    verb = reader.peek().text
    participle = reader.is_at("verb") and verb.split()[0].endswith("ing")
    if not participle or verb.startswith((*ENDING, "swing", "bring ")):
        return False
    rest = itertools.takewhile(lambda token: token.kind != "stop", reader.tokens[reader.at :])
    return not any(token.kind == "on the way" for token in rest)
