"""Our own compiler: progression at once where that stays small, else part by part.

Progression keeps states in disjunctive normal form, which a conjunction of many alternatives
blows up though its automaton is small. Such a formula is cut at its outermost & or |, the
parts are compiled by themselves and made minimal, and their products are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.mission.logic.formula import Formula, neg
from edge.mission.logic.limits import CompileError, Limits
from edge.mission.logic.minimise import minimal
from edge.mission.logic.progression import explore

# States wider than this are left to the product, where there is something to cut.
_MAX_CLAUSES = 24
_MAX_CUTS = 16


def language(
    formula: Formula, letters: Sequence[str], limits: Limits, cuts: int = _MAX_CUTS
) -> tuple[np.ndarray, np.ndarray]:
    """The minimal complete automaton of a formula over given letters and NOTHING.

    Args:
        letters: distinct; at least the propositions of the formula.
        cuts: how deep the formula may be cut into parts.

    Returns:
        delta (n, len(letters) + 1) int32, NOTHING last, and accepting (n,) bool; state 0 is
        initial, states are numbered breadth-first.

    Raises:
        CompileError: a limit was passed.
    """
    op, parts = _parts(formula)
    if not parts or not cuts:
        return _progressed(formula, letters, limits, None)
    try:
        return _progressed(formula, letters, limits, _MAX_CLAUSES)
    except CompileError:
        if limits.spent:
            raise
    automata = [language(part, letters, limits, cuts - 1) for part in parts]
    automata.sort(key=lambda a: len(a[0]), reverse=True)
    result = automata.pop()
    while automata:
        result = minimal(*_product(op, result, automata.pop(), limits), limits)
    return result


def _progressed(
    formula: Formula, letters: Sequence[str], limits: Limits, max_clauses: int | None
) -> tuple[np.ndarray, np.ndarray]:
    rows, accepting = explore(formula, letters, limits, max_clauses)
    return minimal(np.array(rows, np.int32), np.array(accepting), limits)


def _parts(formula: Formula) -> tuple[str, list[Formula]]:
    """& or | and its operands, negation and implication seen through; no operands of others."""
    negated = False
    while formula.op == "!":
        formula, negated = formula.args[0], not negated
    op, parts = formula.op, list(formula.args)
    if op == "->":
        op, parts = "|", [neg(parts[0]), parts[1]]
    if op not in ("&", "|"):
        return op, []
    if not negated:
        return op, parts
    return "|" if op == "&" else "&", [neg(part) for part in parts]


def _product(
    op: str,
    a: tuple[np.ndarray, np.ndarray],
    b: tuple[np.ndarray, np.ndarray],
    limits: Limits,
) -> tuple[np.ndarray, np.ndarray]:
    """The reachable product of two automata over the same letters, initial state first."""
    (delta_a, accepts_a), (delta_b, accepts_b) = a, b
    width = len(delta_b)
    index = {0: 0}  # pair i * width + j -> state
    rows, pairs = [], [np.zeros(1, np.int64)]
    while len(pairs[-1]):
        i, j = np.divmod(pairs[-1], width)
        limits.spend_cells(len(i) * delta_a.shape[1])
        targets = delta_a[i].astype(np.int64) * width + delta_b[j]
        distinct, place = np.unique(targets, return_inverse=True)
        known = len(index)
        states = [index.setdefault(pair, len(index)) for pair in distinct.tolist()]
        limits.check_states(len(index))
        number = np.array(states, np.int32)
        rows.append(number[place.reshape(targets.shape)])
        pairs.append(distinct[number >= known])
    i, j = np.divmod(np.concatenate(pairs), width)
    accepting = accepts_a[i] & accepts_b[j] if op == "&" else accepts_a[i] | accepts_b[j]
    return np.concatenate(rows), accepting
