"""Linear temporal logic over finite words (LTLf): formulas, their text, their meaning.

A word is what the robot reached, one object or nothing per step (ViTL IV-A). Semantics as in
De Giacomo and Vardi, "Linear temporal logic and linear dynamic logic on finite traces" (IJCAI
2013), extended to the empty word: a proposition, X, F, U and M are false of it; WX, G, R and W
are true; ! negates.

>>> f = parse("F ((chair | couch) & F tv)")
>>> holds(f, ["couch", None, "tv"]), holds(f, ["tv", "couch"])
(True, False)
"""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.logic.formula import (
    FALSE,
    TRUE,
    Formula,
    always,
    ap,
    conj,
    disj,
    eventually,
    iff,
    implies,
    neg,
    next_,
    postorder,
    propositions,
    release,
    strong_release,
    to_text,
    until,
    weak_next,
    weak_until,
)
from edge.mission.logic.ltl_parser import FormulaError, parse, parse_prefix

__all__ = [
    "FALSE", "TRUE", "Formula", "FormulaError", "always", "ap", "conj", "disj", "eventually",
    "holds", "iff", "implies", "neg", "next_", "parse", "parse_prefix", "postorder",
    "propositions", "release", "strong_release", "to_text", "until", "weak_next", "weak_until",
]  # fmt: skip


def holds(f: Formula, word: Sequence[str | None]) -> bool:
    """Whether a word satisfies a formula, straight from the definition (a reference, not fast).

    Args:
        word: per step the one object that was reached, or None.
    """
    # Truth at every step, and in the last entry of the empty word. Operands come first, which
    # stands for the definition's recursion.
    truth: dict[int, list[bool]] = {}
    for node in postorder(f):
        args = [truth[id(arg)] for arg in node.args]
        truth[id(node)] = [_holds_at(node, args, word, i) for i in range(len(word) + 1)]
    return truth[id(f)][0]


def _holds_at(f: Formula, args: list[list[bool]], word: Sequence[str | None], i: int) -> bool:
    n = len(word)
    steps = range(i, n)
    match f.op:
        case "true":
            return True
        case "false":
            return False
        case "ap":
            return i < n and word[i] == f.name
        case "!":
            return not args[0][i]
        case "&":
            return all(arg[i] for arg in args)
        case "|":
            return any(arg[i] for arg in args)
        case "->":
            return not args[0][i] or args[1][i]
        case "<->":
            return args[0][i] == args[1][i]
        case "X":
            return i + 1 < n and args[0][i + 1]
        case "WX":
            return i + 1 >= n or args[0][i + 1]
        case "F":
            return any(args[0][j] for j in steps)
        case "G":
            return all(args[0][j] for j in steps)
        case "U":
            return any(args[1][j] and all(args[0][i:j]) for j in steps)
        case "W":
            until_b = any(args[1][j] and all(args[0][i:j]) for j in steps)
            return until_b or all(args[0][i:n])
        case "R":
            return all(args[1][j] or any(args[0][i:j]) for j in steps)
        case "M":
            return any(args[0][j] and all(args[1][i : j + 1]) for j in steps)
    raise ValueError(f"unknown operator {f.op!r}")
