"""Prefix notation of formulas, as the network writes them.

Each operator comes before its operands, and has a fixed number of them. So no parentheses are
needed, and every beginning of a formula can be completed. In addition to the operators of
`logic.ltl` there are abbreviations: `>=n x`, `<=n x` and `=n x` count separate visits to x. `O x y`
is at most one visit to x before the first y.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from edge.mission.language.grammar.goal_tree import Visit, at_most, at_most_before, formula_of_goal
from edge.mission.logic.ltl import (
    TRUE,
    Formula,
    always,
    ap,
    conj,
    disj,
    eventually,
    implies,
    neg,
    next_,
    weak_until,
)

MOST_NAMES = 8
"""Largest number of names in a formula."""
NAMES = tuple(f"<{i}>" for i in range(MOST_NAMES))
"""Placeholders of the objects of an instruction, in the order of their first mention."""
COUNTS = range(1, 6)
"""Numbers of visits that an operator can count."""
REFUSED = "<refused>"
"""Output instead of a formula, if no formula expresses the instruction."""


def _options(f: Formula) -> tuple[str, ...]:
    """Return the names of a proposition, or of a disjunction of propositions."""
    return tuple(part.name for part in (f.args if f.op == "|" else (f,)))


def _at_least(f: Formula, n: int) -> Formula:
    return formula_of_goal(Visit(_options(f), n), TRUE, frozenset())


def _at_most(f: Formula, n: int) -> Formula:
    return at_most(_options(f), n)


def _exactly(f: Formula, n: int) -> Formula:
    return conj(_at_least(f, n), _at_most(f, n))


def _counting(make: Callable[[Formula, int], Formula], n: int) -> Callable[[Formula], Formula]:
    """Return the operator that counts n visits; a function, so that each lambda has its own n."""
    return lambda f: make(f, n)


OPERATORS: dict[str, tuple[int, Callable[..., Formula]]] = {
    "F": (1, eventually),
    "G": (1, always),
    "X": (1, next_),
    "!": (1, neg),
    "&": (2, conj),
    "|": (2, disj),
    "W": (2, weak_until),
    "->": (2, implies),
    "<->": (2, lambda x, y: Formula("<->", (x, y))),
    "O": (2, lambda x, y: at_most_before(_options(x), 1, _options(y))),
} | {
    f"{sign}{n}": (1, _counting(make, n))
    for sign, make in ((">=", _at_least), ("<=", _at_most), ("=", _exactly))
    for n in COUNTS
}  # fmt: skip
"""Token → number of operands, and the function that makes a formula of them."""
_OF_NAMES = {"!", "O"} | {token for token in OPERATORS if token[-1].isdigit()}
"""Operators whose operands are names, or names joined by "|". That of "!" is a single name."""


def arity(token: str) -> int:
    """Return the number of operands of the token."""
    return OPERATORS[token][0] if token in OPERATORS else 0


def allowed(written: Sequence[str], n_names: int, most: int) -> Iterator[str]:
    """Yield the tokens that may come next, so that the formula can be completed within the limits.

    None is yielded when the formula is complete.
    """
    n_missing = 1  # operands that are missing
    name_only = [False]  # for each missing operand: True if it must be a name or a choice of names
    for token in written:
        inside = name_only.pop()
        name_only += [inside or token in _OF_NAMES] * arity(token)
        n_missing += arity(token) - 1
    if n_missing == 0:
        return
    n_free = most - len(written) - n_missing  # tokens left after the missing operands
    yield from NAMES[:n_names]
    if name_only[-1]:
        if n_free >= 2 and (not written or written[-1] != "!"):
            yield "|"
    else:
        yield from (token for token, (n, _) in OPERATORS.items() if n_free >= n)
    if not written:
        yield REFUSED


def formula_of(tokens: Sequence[str], names: Sequence[str]) -> Formula:
    """Return the formula of tokens, in which `NAMES[i]` stands for `names[i]`.

    Raises:
        ValueError: the tokens are no formula.

    Example:
        >>> str(formula_of(["F", "&", "<0>", "F", "<1>"], ["bed", "sofa"]))
        'F (bed & F sofa)'
    """
    done: list[Formula] = []
    for token in reversed(tokens):
        if token in NAMES[: len(names)]:
            done.append(ap(names[NAMES.index(token)]))
        elif token in OPERATORS and arity(token) <= len(done):
            done.append(OPERATORS[token][1](*(done.pop() for _ in range(arity(token)))))
        else:
            break
    else:
        if len(done) == 1:
            return done[0]
    raise ValueError(
        f"{' '.join(tokens)!r} is not a formula in prefix notation over {len(names)} names"
    )
