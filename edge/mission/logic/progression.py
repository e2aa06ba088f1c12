"""All states that a formula can progress to: a complete automaton, not yet minimal."""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.logic.formula import Formula
from edge.mission.logic.limits import Limits
from edge.mission.logic.nnf import Nodes
from edge.mission.logic.normal_form import FALSE, TRUE, Dnf, Rewriter, bits


def explore(
    formula: Formula, letters: Sequence[str], limits: Limits, max_clauses: int | None = None
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
    nodes = Nodes(formula, letters, limits)
    rewriter = Rewriter(nodes, len(letters), limits, max_clauses)
    steps = _Steps(rewriter, limits)
    # State 0 is the formula itself, which as a function of atoms may be far wider than what it
    # progresses to; a twin of it is merged later.
    states: list[Dnf] = [FALSE]
    index: dict[Dnf, int] = {}
    rows: list[list[int]] = []

    def number(state: Dnf) -> int:
        found = index.get(state)
        if found is None:
            found = index[state] = len(states)
            limits.check_states(found)
            states.append(state)
        return found

    rows.append([number(rewriter.after(nodes.root, k)) for k in range(len(letters) + 1)])
    n = 1
    while n < len(states):
        state = states[n]
        limits.spend(len(state) * (len(letters) + 1))
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

    def __init__(self, rewriter: Rewriter, limits: Limits) -> None:
        self.open_ended = 0
        self.changed = [0] * (rewriter.nothing + 1)
        self._known = 0
        self._rewriter = rewriter
        self._limits = limits
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
            self._limits.spend(self._rewriter.per_implicant * len(product))
            for p in product:
                parts.add(base | p)
        return TRUE if 0 in parts else self._rewriter.primes(parts)
