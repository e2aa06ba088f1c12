"""Formulas seen as what they ask for: alternatives of sets of sequences of visits.

F(a & (F b | F c) & F d) asks for "a, then d" and one of "a, then b" and "a, then c". Sequences
distribute over & and | because whatever they ask for later is also asked for earlier.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from edge.mission.ltl import Formula

MAX_ALTERNATIVES = 32


@dataclass(frozen=True, slots=True)
class Stop:
    """One of these, so many separate times."""

    options: tuple[str, ...]
    times: int = 1


Chain = tuple[Stop, ...]
Alternatives = list[tuple[Chain, ...]]


def options_of(f: Formula) -> tuple[str, ...] | None:
    """The names of a proposition or of a disjunction of propositions; None of anything else."""
    parts = f.args if f.op == "|" else (f,)
    return tuple(part.name for part in parts) if all(p.op == "ap" for p in parts) else None


def alternatives_of(f: Formula) -> Alternatives | None:
    """Sets of chains, any one set of which fulfils the formula; None if it is not of that kind."""
    if f.op == "|":
        each = [alternatives_of(part) for part in f.args]
        if any(a is None for a in each):
            return None
        return _capped([chains for a in each if a is not None for chains in a])
    if f.op == "&":
        return _all_of(f.args)
    return _sequence(f) if f.op == "F" else None


def _capped(found: Alternatives) -> Alternatives | None:
    return found if len(found) <= MAX_ALTERNATIVES else None


def _all_of(parts: tuple[Formula, ...]) -> Alternatives | None:
    found: Alternatives = [()]
    for part in parts:
        more = alternatives_of(part)
        if more is None or len(found) * len(more) > MAX_ALTERNATIVES:
            return None
        found = [(*a, *b) for a, b in product(found, more)]
    return found


def _sequence(f: Formula) -> Alternatives | None:
    """F(p & what follows), F((p | q) & …), and p several times."""
    body = f.args[0]
    options = options_of(body)
    if options is not None:
        return [((Stop(options),),)]
    if body.op != "&":
        return None
    first, *rest = body.args
    options = options_of(first)
    if options is None:
        return None
    again = _once_more(first, rest)
    if again is not None:
        later = _sequence(again)
        return later and [
            tuple((Stop(s.options, s.times + 1), *more) for s, *more in chains) for chains in later
        ]
    found = _all_of(tuple(part.args[0] if part.op == "X" else part for part in rest))
    strict = all(part.op == "X" for part in rest)
    if found is None or not all(
        strict or not set(chain[0].options) & set(options) for chains in found for chain in chains
    ):
        return None
    return [tuple((Stop(options), *chain) for chain in chains) for chains in found]


def _once_more(first: Formula, rest: list[Formula]) -> Formula | None:
    """g in F(p & F(!p & g)), g of the form F(p …); None if it is not of that form."""
    if len(rest) != 1 or rest[0].op != "F" or rest[0].args[0].op != "&":
        return None
    gap, *more = rest[0].args[0].args
    if gap != Formula("!", (first,)) or len(more) != 1 or more[0].op != "F":
        return None
    body = more[0].args[0]
    starts = body.args[0] if body.op == "&" else body
    return more[0] if starts == first else None
