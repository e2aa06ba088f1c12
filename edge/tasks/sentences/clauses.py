"""Order in which the clauses of an instruction are driven; `edge.tasks.sentences.reading` uses it.

"Go to the gate after passing the van" passes the van first. The tokens of such clauses are put into
driving order. An instruction with an unclear order is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NoReturn

from edge.mission.language.words.tokens import Token, TokenReader

_JOINTS = ("then", "and", "comma", "stop mark")  # kinds of tokens that join clauses
_VERBS = {
    "going": "go", "passing": "pass", "stopping": "stop", "reaching": "reach", "leaving": "leave",
}  # fmt: skip
"""Kind of a participle → kind of its verb."""
_SKIPPED = ("filler", "having", "while")  # kinds of tokens before the verb of a clause


@dataclass(slots=True)
class _Clause:
    """Tokens up to the next joint, or up to the next clause that depends on this one.

    Attributes:
        depends: dependence on another clause, its *main* clause: "after", "before", "by" (the
            manner of driving: "with the van on your left"); "" = none.
        joints: tokens that join this clause to the one before; empty for the first clause, and for
            a clause that follows without a joint.
        tokens: the tokens of the clause, without joints.
    """

    depends: str
    joints: list[Token]
    tokens: list[Token] = field(default_factory=list)


def order_clauses(text: str, tokens: list[Token]) -> list[Token]:
    """Put the clauses of an instruction into the order in which they are driven.

    Args:
        text: the instruction.
        tokens: result of `edge.tasks.sentences.phrases.tokenise`, with "end" at the end.

    Returns:
        The same tokens if no clause depends on another. Otherwise participles become verbs.

    Raises:
        TranslationError: the order is not clear; the error names the clause.
    """
    clauses = _split_clauses(tokens)
    if not any(clause.depends for clause in clauses):
        return tokens
    ordered: list[_Clause] = []
    for_next: list[_Clause] = []  # "before …" at the start: driven after the next clause
    for n, clause in enumerate(clauses):
        after = clauses[n + 1] if n + 1 < len(clauses) else None
        main_follows = after is not None and not after.depends and _are_commas(after.joints)
        if not clause.depends:
            ordered += [clause, *for_next]
            for_next = []
        elif not ordered or (clause.joints and not _are_commas(clause.joints)):
            # The clause comes before its main one: "after passing the van, go to the gate".
            if not main_follows or for_next:
                _refuse(text, tokens, clause)
            (for_next if clause.depends == "before" else ordered).append(clause)
        elif (  # "go to the gate, passing the van, go to the tree": which step passes the van?
            (clause.joints and main_follows)
            or ordered[-1].depends
            or not _has_clear_order(clauses[n - 1 : n + 1])
        ):
            _refuse(text, tokens, clause)
        elif clause.depends == "before":  # "go to the gate before passing the van"
            ordered.append(clause)
        else:  # "go to the gate after passing the van": driven before the last clause
            ordered.insert(len(ordered) - 1, clause)
    # By the identity of a clause, the clause before it in the text.
    before_in_text = dict(zip(map(id, clauses[1:]), clauses, strict=False))
    joined: list[Token] = []
    for last, clause in zip([None, *ordered], ordered, strict=False):
        # The clause may describe the last one or the main clause of both.
        is_ambiguous = clause.depends == "by" and last is not None and last.depends
        # `it` must mean the same object in the text and in driving order.
        if _refers(clause) and (is_ambiguous or before_in_text.get(id(clause)) is not last):
            _refuse(text, tokens, clause)
        first = clause.tokens[0]
        comma = Token("comma", ",", first.start, first.start)
        joint = next((joint for joint in clause.joints if joint.kind != "comma"), comma)
        joined += [joint, *clause.tokens] if joined else clause.tokens
    return [*joined, tokens[-1]]


def list_in_order(tokens: list[Token]) -> list[Token]:
    """Return the tokens with "then" between the parts of a list that ends with "in that order"."""
    if not any(token.kind == "in order" for token in tokens):
        return tokens
    return [
        replace(token, kind="then") if token.kind in ("comma", "and") else token
        for token in tokens
        if token.kind != "in order"
    ]


def _has_clear_order(pair: list[_Clause]) -> bool:
    """Return True if it is clear when the second clause of a pair, a dependent one, is driven.

    "With the gate on your left" may describe either of two clauses before it. Two objects that are
    passed at once are passed in either order.
    """
    last, clause = pair
    if last.depends:
        return last.depends == clause.depends == "by"
    passes = any(token.kind in ("pass", "past", "around", "leave") for token in last.tokens)
    return clause.depends != "by" or not passes


def _refers(clause: _Clause) -> bool:
    """Return True if a clause refers to an object of the clause before it by `it` or `its`.

    In "with the van on its left", `its` refers to the van in the same clause.
    """
    return any(
        token.kind == "pronoun"
        or (token.kind.startswith("its ") and not any(t.kind == "word" for t in clause.tokens[:n]))
        for n, token in enumerate(clause.tokens)
    )


def _split_clauses(tokens: list[Token]) -> list[_Clause]:
    """Split an instruction into its clauses; none is empty."""
    found = [_Clause("", [])]
    at = 0
    while tokens[at].kind != "end":
        token, open_clause = tokens[at], found[-1]
        depends, skip = _dependence(tokens, at)
        if depends:
            joints = [] if open_clause.tokens else open_clause.joints
            found.append(_Clause(depends, joints))
            at = _clause_at(tokens, at + skip)
        elif token.kind in _JOINTS:
            verb = tokens[at + 1]
            if token.kind == "and" and open_clause.depends and verb.kind in _VERBS:
                # "after passing the van and stopping at the gate"
                open_clause.tokens.append(token)
            elif open_clause.tokens:
                found.append(_Clause("", [token]))
            else:
                open_clause.joints.append(token)
            at += 1
            continue
        if (depends or found[-1].depends) and tokens[at].kind in _VERBS:
            begins = not found[-1].tokens or found[-1].tokens[-1].kind == "and"
            verb = tokens[at]
            found[-1].tokens.append(replace(verb, kind=_VERBS[verb.kind]) if begins else verb)
            at += 1
        elif not depends:
            found[-1].tokens.append(token)
            at += 1
    return [clause for clause in found if clause.tokens]


def _dependence(tokens: list[Token], at: int) -> tuple[str, int]:
    """Return how a clause that begins here depends on another, and the number of marker tokens.

    "Passing", "leaving", "with" and "going past" describe how another clause is driven.
    """
    token = tokens[at]
    if token.kind in ("after", "before"):
        verb = tokens[_clause_at(tokens, at + 1)].kind
        return (token.kind, 1) if verb in _VERBS or verb in _VERBS.values() else ("", 0)
    if token.kind == "while":
        return ("by", 1) if _describes_manner(tokens, at + 1) else ("", 0)
    joined = at > 0 and tokens[at - 1].kind == "and"
    return ("by", 0) if _describes_manner(tokens, at) and not joined else ("", 0)


def _describes_manner(tokens: list[Token], at: int) -> bool:
    """Return True if a clause that describes the manner of another begins here."""
    token, following = tokens[at], tokens[min(at + 1, len(tokens) - 1)]
    goes_past = token.kind == "going" and following.kind in ("past", "around")
    return goes_past or token.kind in ("passing", "leaving")


def _clause_at(tokens: list[Token], at: int) -> int:
    """Return the index of the verb of a clause that begins at an index."""
    while tokens[at].kind in _SKIPPED:
        at += 1
    return at


def _are_commas(joints: list[Token]) -> bool:
    return bool(joints) and all(joint.kind == "comma" for joint in joints)


def _refuse(text: str, tokens: list[Token], clause: _Clause) -> NoReturn:
    hint = "it is not clear when to drive this; say the steps in their order, with 'then'"
    if _refers(clause):
        hint = "it is not clear what this refers to; name the object"
    first = next(token for token in tokens if token.start == clause.tokens[0].start)
    TokenReader(text, tokens).refuse(hint, first)
