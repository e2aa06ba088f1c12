"""Relation of a clause to the one before it: independent, after it, or on the way to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge.mission.language.grammar.clause_parts import Clause
from edge.mission.language.grammar.meaning import ClauseMeaning, permission_of
from edge.mission.language.grammar.routes import PASSING
from edge.mission.language.words.lexicon import AVOIDING
from edge.mission.language.words.noun_phrases import NounPhrase
from edge.mission.language.words.tokens import ONE_ROBOT, Token, TokenReader

THEN = ("then", "only then")
"""Kinds of token that put the next clause after the one before."""
JOINTS = ("comma", "and", "but", *THEN)
"""Kinds of token between clauses, in increasing strength: of several, the strongest applies."""

_MOVES = (  # verbs of a plain order to go somewhere
    "go", "move", "walk", "drive", "head", "travel", "come", "proceed", "enter", "continue", "pass",
    "navigate", "cross", "fly", "climb", "follow", "traverse", "return",
)  # fmt: skip
# Beginnings of phrases for taking a path: "take the road through".
_WAYS = ("take the ", "use the ", "take a ", "use a ", "follow the ", "choose the ")
_ARRIVES = ("arrive", "reach", "get")  # beginnings of verbs for arriving
ENDING = ("conclude ", "end ", "ends ", "ending ", "finish")
"""Beginnings of verbs that end a mission: "end at the bed"."""
_ENDING = (*ENDING, "your ", "the ")  # also "your last stop is …"
# Beginnings of verbs that continue an order.
_ONWARD = ("proceed", "continue", "keep ", "go on", "carry on", *_ENDING)
_ALSO = ("also", "too", "as well", "at some point")  # words for a goal at any time


@dataclass(slots=True)
class Flow:
    """Facts about the last clause that decide where the next clause belongs."""

    # True if the clause was a plain order to go somewhere: "go to a go to b" is in order
    moved: bool = False
    passed: bool = False  # True if the clause only passed through somewhere
    verb: str = ""
    # True if the clause forbade something, so that a bare "then the bed" is ambiguous
    denied: bool = False
    barred: bool = False  # True if the clause was a plain "do not visit a"
    until: NounPhrase | None = None  # objects that end the clause's ban
    # token of a clause that began with "if …" or "you may …": the next clause may belong to it
    hanging: Token | None = None
    permitted: NounPhrase | None = None  # objects that the clause allowed, if it asked for nothing
    agent: str = ""  # name that the instruction has used for the robot so far

    def comes_after(
        self,
        clause: Clause,
        joint: Token | None,
        sequence: Sequence[ClauseMeaning],
        asked: bool,
        reader: TokenReader,
    ) -> bool:
        """Return True if a clause comes after all clauses before it.

        Otherwise the clause may be marked as on the way there (`clause.enroute`). Also stores facts
        about this clause for the next one.

        `joint` is the token before the clause, None at the start of a sentence. `sequence` has the
        steps of the sentence so far. `asked`: earlier sentences asked for something.
        """
        kind = joint.kind if joint else None
        also = clause.token.text in _ALSO
        # "go to a. go to b." is in order, unless other words contradict it.
        any_order = also or any(token.text in _ALSO for token in _sentence_tokens(reader))
        any_order = any_order or any(token.kind in (*THEN, "any order") for token in reader.tokens)
        ensures = clause.token.kind == "ensure"
        moves = _moves(clause)
        through = clause.through and not clause.route
        passes = through and (ensures or kind == "but")  # "be sure to proceed through b"
        onward = clause.verb.startswith(_ONWARD) and not clause.negated
        bare = clause.verb == "" and not clause.negated
        reaches = moves or bare or (clause.verb.startswith(_ARRIVES) and not clause.negated)
        after = any(
            (
                clause.trails,  # "go to b after that"
                kind in THEN,
                # "return to a"
                clause.returns and (sequence or asked) and not clause.negated,
                # "go to a, proceed to b"
                onward and sequence and not (sequence[-1].loose or passes),
                # "go to a. Finish at b."
                onward and asked and clause.verb.startswith(_ENDING),
                # "go to a go to b"
                moves and self.moved and kind == "" and not ensures,
                # "go to a. Go to b."
                moves and self.moved and kind is None and asked and not (any_order or through),
                # "go through b and go to a"
                reaches and self.passed and joint and not also,
                # "via b, go to a"
                self.passed and not self.verb and not clause.negated and kind in ("", "comma"),
            )
        )
        last = reader.is_at("end") or reader.is_at("end", ahead=1)
        passing = through and moves and not after and not self.passed
        if passing and not sequence and not also and last:
            clause.enroute = asked  # "go to a. Please go through b."
        elif passing and sequence and (ensures or kind == "but" or clause.by_way):
            clause.enroute = True  # "go to a, making sure to go through b"
        elif passing and sequence and self.moved:
            clause.enroute = reader.pick(clause.token, 2) == 0
        elif any(token.kind == "any order" for token in reader.tokens):
            pass
        elif moves and self.moved and not (after or also) and joint and kind == "and":
            after = reader.pick(joint, 2) == 1  # "go to a and go to b" may be in order
        still_passing = bool(clause.targets) and bare and self.passed  # "through a, then b, to c"
        self.moved, self.passed = moves, (through or still_passing) and not clause.negated
        self.verb = clause.verb
        return after

    def lists(self, clause: Clause, joint: Token | None) -> bool:
        """Return True if an order follows "do not …" and a comma."""
        comma = joint is not None and joint.kind == "comma"
        return comma and self.denied and not clause.negated

    def refuse_joined(
        self, clause: Clause, joint: Token | None, started: bool, reader: TokenReader
    ) -> None:
        """Refuse a clause that could belong to the last clause in several ways.

        Raises:
            UnclearError: it could.
        """
        kind = joint.kind if joint else ""
        # "Before you go to a, visit b and …" joins the next part; "then" makes it unclear.
        leads = self.hanging is not None and self.hanging.kind == "before"
        joined = joint is not None and kind not in ("but", "or") and (not leads or kind in THEN)
        if self.hanging and joined and not (clause.subject or clause.conditions):
            hint = "unclear if the next part depends on this; use a separate sentence"
            reader.refuse_finally(hint, self.hanging)
        bare = clause.verb == "" and not (clause.conditions or clause.count)
        listed = clause.targets is not None and clause.targets.listed
        if bare and clause.negated and (self.denied or not started or listed):
            # "not a, b"
            reader.refuse_finally("unclear: avoid it or visit it? say which", clause.token)
        if clause.agent and self.agent not in ("", clause.agent):
            reader.refuse_finally(ONE_ROBOT, clause.token)
        several = clause.targets is not None and len(clause.targets.groups) > 1
        joins = several and any(token.kind == "and" for token in _clause_tokens(clause, reader))
        if bare and clause.negated and joins:
            hint = "unclear what 'not' applies to; use a separate sentence"
            reader.refuse_finally(hint, clause.token)
        if not started and joint is not None and joint.text in ("later", "afterwards"):
            reader.refuse_finally("no step comes before this one", joint)
        if kind == "but" and bare and not (clause.negated or clause.first):
            hint = "unclear: all except this, or this too? say 'visit …'"
            reader.refuse_finally(hint, clause.token)
        if kind == "or" and clause.through and clause.verb == "":
            reader.refuse_finally("say 'through a or b'", clause.token)  # "to a via b or via c"
        if clause.bound_by and kind == "or":
            reader.refuse("unclear which one is on the way; say so for each", clause.bound_by)

    def note(self, clause: Clause, meaning: ClauseMeaning) -> None:
        """Store facts about a clause for the next one."""
        ends = [c for c in clause.conditions if c.kind == "until" and not c.denied]
        self.until = ends[0].targets if clause.negated and len(ends) == 1 else None
        shuns = clause.verb in AVOIDING or clause.elsewhere
        self.barred = bool(meaning.bans) and not (shuns or self.until)
        self.hanging = clause.token if _hangs(clause) else None
        self.permitted = permission_of(clause)
        self.denied = clause.negated
        self.agent = clause.agent or self.agent


def _sentence_tokens(reader: TokenReader) -> Sequence[Token]:
    """Return the tokens of the sentence at or before the reader's position."""
    ends = [i for i, token in enumerate(reader.tokens) if token.kind in ("stop", "end")]
    begin = next((i + 1 for i in reversed(ends) if i < reader.at), 0)
    until = next(i for i in ends if i >= reader.at)
    return reader.tokens[begin:until]


def _clause_tokens(clause: Clause, reader: TokenReader) -> Sequence[Token]:
    """Return the tokens of the clause that was just parsed."""
    begin = next(i for i, token in enumerate(reader.tokens) if token is clause.token)
    return reader.tokens[begin : reader.at]


def _hangs(clause: Clause) -> bool:
    """Return True for a duty with a condition, or a permission."""
    answers = any(
        (c.kind == "when" and not c.only) or (c.kind == "before" and c.token is clause.token)
        for c in clause.conditions
    )
    return answers or (clause.mood == "can" and not (clause.negated or clause.count))


def _moves(clause: Clause) -> bool:
    """Return True for a plain order to go somewhere."""
    rides = clause.verb.startswith(_WAYS) and clause.verb.endswith(PASSING)
    more = clause.only or clause.count or clause.conditions or clause.enroute or clause.first
    goes = clause.verb in _MOVES or clause.verb.startswith("continue ")
    return (rides or goes) and not (clause.negated or more)
