"""Our own compiler: progression at once where that stays small, else part by part.

Progression keeps states in disjunctive normal form, which a conjunction of many alternatives
blows up though its automaton is small. Such a formula is cut at its outermost & or |, the
parts are compiled by themselves and made minimal, and their products are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.mission.logic.limits import CompileError, Effort
from edge.mission.logic.normal_form import FALSE, TRUE, Dnf, Nodes, Rewriter, bits
from edge.mission.ltl import Formula, neg

# Below this many transitions plain Python is faster than NumPy.
_SMALL = 256
# As many cells take as long as calling NumPy for one column does.
_CALL = 500


def minimal(
    delta: np.ndarray, accepting: np.ndarray, effort: Effort
) -> tuple[np.ndarray, np.ndarray]:
    """Merge equivalent states by partition refinement (Moore).

    States that can be reached are numbered breadth-first, letters in their order.

    Args:
        delta: (n, k) int32, next states of a complete automaton; state 0 is initial.
        accepting: (n,) bool.

    Returns:
        delta (m, k) int32 and accepting (m,) bool of the minimal automaton.
    """
    refine = _refine_small if delta.size <= _SMALL else _refine
    block = refine(delta, accepting, effort)
    _, first = np.unique(block, return_index=True)
    return _numbered(block[delta[first]], accepting[first], int(block[0]))


def _refine(delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> np.ndarray:
    """(n,) int64, which states are equivalent, as numbers without gaps."""
    n = len(delta)
    block, count = accepting.astype(np.int64), int(accepting.max()) + int(not accepting.all())
    while count < n:
        effort.spend_cells((n + _CALL) * delta.shape[1])
        # As many columns as fit are packed into one int64, which sorts fast.
        key, size = block, count
        for column in delta.T:
            if size * count >= 2**62:
                key, size = _dense(key)
            key, size = key * count + block[column], size * count
        finer, new_count = _dense(key)
        if new_count == count:
            break
        block, count = finer, new_count
    return _dense(block)[0]


def _dense(key: np.ndarray) -> tuple[np.ndarray, int]:
    values, dense = np.unique(key, return_inverse=True)
    return dense.reshape(-1), len(values)


def _refine_small(delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> np.ndarray:
    """What `_refine` does, for few states."""
    rows, block, count = delta.tolist(), accepting.tolist(), 0
    while count < len(rows):
        effort.spend(delta.size)
        ids: dict[tuple, int] = {}
        block = [
            ids.setdefault((own, *[block[t] for t in row]), len(ids))
            for own, row in zip(block, rows, strict=True)
        ]
        if len(ids) == count:
            break
        count = len(ids)
    return np.array(block, np.int64)


def _numbered(
    delta: np.ndarray, accepting: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray]:
    rows = delta.tolist()
    order = {start: 0}
    queue = [start]
    for state in queue:
        for target in rows[state]:
            if target not in order:
                order[target] = len(order)
                queue.append(target)
    number = np.empty(len(rows), np.int32)
    number[queue] = np.arange(len(queue), dtype=np.int32)
    return number[delta[queue]], accepting[queue]


def explore(
    formula: Formula, letters: Sequence[str], effort: Effort, max_clauses: int | None = None
) -> tuple[list[list[int]], list[bool]]:
    """Progress a formula over all words, breadth-first.

    Args:
        max_clauses: the most prime implicants a state may have; None: any number.

    Returns:
        Rows of next states, state 0 first, a column per letter and a last one for NOTHING; and
        which states accept.

    Raises:
        CompileError: a limit was passed; TooWide where it was `max_clauses`.
    """
    nodes = Nodes(formula, letters, effort)
    rewriter = Rewriter(nodes, len(letters), effort, max_clauses)
    steps = _Steps(rewriter, effort)
    # State 0 is the formula itself, which as a function of atoms may be far wider than what it
    # progresses to; a twin of it is merged later.
    states: list[Dnf] = [FALSE]
    index: dict[Dnf, int] = {}
    rows: list[list[int]] = []

    def number(state: Dnf) -> int:
        found = index.get(state)
        if found is None:
            found = index[state] = len(states)
            effort.check_states(found)
            states.append(state)
        return found

    rows.append([number(rewriter.after(nodes.root, k)) for k in range(len(letters) + 1)])
    n = 1
    while n < len(states):
        state = states[n]
        effort.spend(len(state) * (len(letters) + 1))
        union = 0
        for clause in state:
            union |= clause
        steps.learn(union)
        rows.append(
            [
                number(steps.take(state, letter)) if union & changed else n
                for letter, changed in enumerate(steps.changed)
            ]
        )
        n += 1
    at_end = [any(not clause & steps.open_ended for clause in state) for state in states]
    at_end[0] = nodes.at_end[nodes.root]
    return rows, at_end


class _Steps:
    """What each letter does to each atom, as far as atoms have come up.

    Attributes:
        open_ended: atoms that have come up and that the empty word does not satisfy, as bits.
        changed: per letter, the atoms that it changes, as bits.
    """

    def __init__(self, rewriter: Rewriter, effort: Effort) -> None:
        self.open_ended = 0
        self.changed = [0] * (rewriter.nothing + 1)
        self._known = 0
        self._rewriter = rewriter
        self._effort = effort
        self._products: list[dict[int, Dnf]] = [{} for _ in self.changed]

    def learn(self, atoms: int) -> None:
        """Work out what every letter does to those of the atoms that are new."""
        new = atoms & ~self._known
        self._known |= new
        nodes, after, nothing = self._rewriter.nodes, self._rewriter.after, self._rewriter.nothing
        for atom in bits(new):
            bit = 1 << atom
            if not nodes.at_end[atom]:
                self.open_ended |= bit
            idle = after(atom, nothing)
            support = nodes.support[atom]
            for letter in range(nothing + 1):
                step = after(atom, letter) if support >> letter & 1 else idle
                if step != (bit,):
                    self.changed[letter] |= bit
                    self._products[letter][bit] = step

    def take(self, state: Dnf, letter: int) -> Dnf:
        """The state after a letter."""
        changed, products = self.changed[letter], self._products[letter]
        parts: set[int] = set()
        for clause in state:
            hit = clause & changed
            if not hit:
                parts.add(clause)
                continue
            product = products.get(hit)
            if product is None:
                each = [products[1 << atom] for atom in bits(hit)]
                product = products[hit] = self._rewriter.join("&", each)
            base = clause ^ hit
            self._effort.spend(self._rewriter.per_implicant * len(product))
            for p in product:
                parts.add(base | p)
        return TRUE if 0 in parts else self._rewriter.primes(parts)


# States wider than this are left to the product, where there is something to cut.
_MAX_CLAUSES = 24
_MAX_CUTS = 16


def language(
    formula: Formula, letters: Sequence[str], effort: Effort, cuts: int = _MAX_CUTS
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
        return _progressed(formula, letters, effort, None)
    try:
        return _progressed(formula, letters, effort, _MAX_CLAUSES)
    except CompileError:
        if effort.spent:
            raise
    automata = [language(part, letters, effort, cuts - 1) for part in parts]
    automata.sort(key=lambda a: len(a[0]), reverse=True)
    result = automata.pop()
    while automata:
        result = minimal(*_product(op, result, automata.pop(), effort), effort)
    return result


def _progressed(
    formula: Formula, letters: Sequence[str], effort: Effort, max_clauses: int | None
) -> tuple[np.ndarray, np.ndarray]:
    rows, accepting = explore(formula, letters, effort, max_clauses)
    return minimal(np.array(rows, np.int32), np.array(accepting), effort)


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
    effort: Effort,
) -> tuple[np.ndarray, np.ndarray]:
    """The reachable product of two automata over the same letters, initial state first."""
    (delta_a, accepts_a), (delta_b, accepts_b) = a, b
    width = len(delta_b)
    index = {0: 0}  # pair i * width + j -> state
    rows, pairs = [], [np.zeros(1, np.int64)]
    while len(pairs[-1]):
        i, j = np.divmod(pairs[-1], width)
        effort.spend_cells(len(i) * delta_a.shape[1])
        targets = delta_a[i].astype(np.int64) * width + delta_b[j]
        distinct, place = np.unique(targets, return_inverse=True)
        known = len(index)
        states = [index.setdefault(pair, len(index)) for pair in distinct.tolist()]
        effort.check_states(len(index))
        number = np.array(states, np.int32)
        rows.append(number[place.reshape(targets.shape)])
        pairs.append(distinct[number >= known])
    i, j = np.divmod(np.concatenate(pairs), width)
    accepting = accepts_a[i] & accepts_b[j] if op == "&" else accepts_a[i] | accepts_b[j]
    return np.concatenate(rows), accepting
