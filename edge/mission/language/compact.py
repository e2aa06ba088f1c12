"""Formulas as the small translator writes them: tokens in prefix notation, of which each but names
has a fixed number of operands, so that every prefix can be completed and none need be parsed twice.

Beside the operators of `logic.ltl` there are a few of its own, for what takes many of those:
`>=n x`, `<=n x` and `=n x` count separate visits to x, and `O x y` is at most one visit to x, and
then y, before y for the first time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from edge.mission.language.goals import Visit, achieved, at_most, at_most_before
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
NAMES = tuple(f"<{i}>" for i in range(MOST_NAMES))
"""What stands for the things of an instruction, in the order in which they are first named."""
COUNTS = range(1, 6)
REFUSED = "<refused>"
"""In the place of a formula: none says this."""


def _options(f: Formula) -> tuple[str, ...]:
    """The names of a proposition, or of a disjunction of propositions."""
    return tuple(part.name for part in (f.args if f.op == "|" else (f,)))


def _at_least(f: Formula, n: int) -> Formula:
    return achieved(Visit(_options(f), n), TRUE, frozenset())


def _at_most(f: Formula, n: int) -> Formula:
    return at_most(_options(f), n)


def _exactly(f: Formula, n: int) -> Formula:
    return conj(_at_least(f, n), _at_most(f, n))


def _counting(made: Callable[[Formula, int], Formula], n: int) -> Callable[[Formula], Formula]:
    return lambda f: made(f, n)


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
    f"{sign}{n}": (1, _counting(made, n))
    for sign, made in ((">=", _at_least), ("<=", _at_most), ("=", _exactly))
    for n in COUNTS
}  # fmt: skip
"""Token → how many operands it has, and what it makes of them."""
_OF_NAMES = {"!", "O"} | {token for token in OPERATORS if token[-1].isdigit()}
"""Tokens whose operands are names, or choices among names."""


def arity(token: str) -> int:
    """How many formulas follow the token."""
    return OPERATORS[token][0] if token in OPERATORS else 0


def allowed(written: Sequence[str], names: int, most: int) -> Iterator[str]:
    """The tokens that may come next, so that a formula over so many names and at most so many
    tokens can be completed; none when it is complete."""
    open_, narrow = 1, [False]
    for token in written:
        inside = narrow.pop()
        narrow += [inside or token in _OF_NAMES] * arity(token)
        open_ += arity(token) - 1
    if open_ == 0:
        return
    room = most - len(written) - open_
    yield from NAMES[:names]
    if narrow[-1]:
        if room >= 2 and (not written or written[-1] != "!"):
            yield "|"
    else:
        yield from (token for token, (n, _) in OPERATORS.items() if room >= n)
    if not written:
        yield REFUSED


def formula_of(tokens: Sequence[str], names: Sequence[str]) -> Formula:
    """The formula that tokens write, `NAMES[i]` being `names[i]`.

    Raises:
        ValueError: they write none.
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
    raise ValueError(f"{' '.join(tokens)!r} writes no formula over {len(names)} names")
