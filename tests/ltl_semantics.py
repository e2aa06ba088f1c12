"""Truth of a formula on a trace, as `edge.mission.logic.ltl` defines it."""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.logic.ltl import Formula, postorder


def holds(f: Formula, word: Sequence[str | None]) -> bool:
    """Return True if a trace satisfies a formula, straight from the definition (slow reference).

    Args:
        f: formula.
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
