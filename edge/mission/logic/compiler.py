"""The compiler "own": builds a minimal automaton for each operator from its operands' automata.

An automaton is a pair of delta (n, columns) int32, a column for each proposition and then NOTHING,
and accepting (n,) bool. It is complete, and state 0 is initial. ! inverts acceptance, & | -> <->
are products, X adds a state in front, and U is a subset construction. The other operators are
rewritten:

    F b = true U b        G b = !F !b               WX a = !X !a
    a M b = b U (a & b)   a W b = !(!b U !(a | b))  a R b = !(!a U !b)

F (p & g) = !p U (p & g) is used if p depends on the next step only, and if g holds earlier
whenever it holds later (as F does). Then the first p decides, and subsets have one state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import reduce

import numpy as np

from edge.mission.logic.limits import PER_NODE, CompileBudget, CompileError
from edge.mission.logic.ltl import Formula, postorder

Dfa = tuple[np.ndarray, np.ndarray]
"""An automaton: delta and accepting, see the module."""
Key = tuple[str, tuple[int, ...], str]  # operator, numbers of its operands, proposition

# Limit of different subformulas; it bounds the memory of a compilation.
MAX_NODES = 10_000
# A NumPy call for one column takes as long as this number of cells.
_CALL_CELLS = 500
_PER_ALTERNATIVE = 16  # steps to advance one alternative by a step

_TABLES = {
    "&": np.logical_and,
    "|": np.logical_or,
    "->": lambda a, b: ~a | b,
    "<->": lambda a, b: a == b,
}


def minimal_automaton(formula: Formula, propositions: Sequence[str], budget: CompileBudget) -> Dfa:
    """Return the minimal complete automaton of a formula over these propositions and NOTHING.

    Returns:
        The pair delta, accepting (see the module); states are numbered breadth-first.

    Raises:
        CompileError: a limit was exceeded.
    """
    nodes = _subformulas(formula, budget)
    uses = Counter(arg for _, args, _ in nodes for arg in args)
    column = {name: k for k, name in enumerate(propositions)}
    automata: dict[int, Dfa] = {}
    for number, (op, args, name) in enumerate(nodes):
        budget.spend(PER_NODE * (1 + len(args)))
        if op == "ap":
            automata[number] = _proposition_automaton(column[name], len(propositions) + 1)
        elif not args:
            automata[number] = (
                np.zeros((1, len(propositions) + 1), np.int32),
                np.array([op == "true"]),
            )
        else:
            automata[number] = _automaton_of(op, [automata[arg] for arg in args], budget)
        uses.subtract(args)
        for arg in {arg for arg in args if not uses[arg]}:
            del automata[arg]
    return minimise(*automata[len(nodes) - 1], budget)


def _subformulas(formula: Formula, budget: CompileBudget) -> list[Key]:
    """Return the different subformulas after rewriting, operands before operators."""
    nodes = _Nodes()
    known: dict[int, int] = {}
    for f in postorder(formula):
        budget.spend(PER_NODE)
        known[id(f)] = nodes.number_rewritten(f, [known[id(arg)] for arg in f.args])
    return nodes.keys[: known[id(formula)] + 1]


class _Nodes:
    """Numbering of subformulas in order of appearance; equal subformulas have one number."""

    def __init__(self) -> None:
        self.keys: list[Key] = []
        self._numbers: dict[Key, int] = {}
        self._negated: dict[int, int] = {}
        # Numbers of subformulas that depend on the next step only, and of subformulas that hold
        # earlier whenever they hold later; see the module.
        self._of_next: set[int] = set()
        self._early: set[int] = set()

    def number(self, op: str, *args: int, name: str = "") -> int:
        """Return the number of a subformula; a new one gets the next number."""
        if op == "!" and args[0] in self._negated:
            return self._negated[args[0]]
        key = (op, args, name)
        if (found := self._numbers.get(key)) is not None:
            return found
        found = self._numbers[key] = len(self.keys)
        if found > MAX_NODES:
            raise CompileError(
                f"formula: more than {MAX_NODES} different subformulas; make it shorter"
            )
        self.keys.append(key)
        if op == "!":
            self._negated[args[0]], self._negated[found] = found, args[0]
        if op == "ap" or (op in ("!", *_TABLES) and self._of_next.issuperset(args)):
            self._of_next.add(found)
        if op in ("&", "|") and self._early.issuperset(args):
            self._early.add(found)
        return found

    def eventually(self, b: int) -> int:
        """Return the number of F b; see the module."""
        op, parts, _ = self.keys[b]
        before = self.number("true")
        first = [part for part in parts if part in self._of_next]
        if op == "&" and first and self._early.issuperset({*parts} - {*first}):
            before = self.number("!", self.number("&", *first) if first[1:] else first[0])
        found = self.number("U", before, b)
        self._early.add(found)
        return found

    def number_rewritten(self, f: Formula, args: list[int]) -> int:
        """Return the number of a subformula, rewritten as the module documents."""
        number = self.number
        match f.op, args:
            case "F", [b]:
                return self.eventually(b)
            case "G", [b]:
                return number("!", self.eventually(number("!", b)))
            case "WX", [a]:
                return number("!", number("X", number("!", a)))
            case "M", [a, b]:
                return number("U", b, number("&", a, b))
            case "W", [a, b]:
                neither = number("!", number("|", a, b))
                return number("!", number("U", number("!", b), neither))
            case "R", [a, b]:
                return number("!", number("U", number("!", a), number("!", b)))
        return number(f.op, *args, name=f.name)


def _proposition_automaton(column: int, width: int) -> Dfa:
    """Return the automaton of a proposition: it is true in the first step."""
    delta = np.full((3, width), 2, np.int32)
    delta[0, column] = delta[1] = 1
    return delta, np.array([False, True, False])


def _automaton_of(op: str, args: list[Dfa], budget: CompileBudget) -> Dfa:
    """Return the minimal automaton of an operator; the order of its states is arbitrary."""
    match op:
        case "!":
            return args[0][0], ~args[0][1]
        case "X":
            return _next(*args[0], budget)
        case "U":
            return minimise(*_Until(*args, budget).automaton(), budget)
        case "&" | "|":  # small operands first, so that intermediate automata stay small
            args = sorted(args, key=lambda dfa: len(dfa[0]))
    return reduce(lambda a, b: minimise(*_product(op, a, b, budget), budget), args)


def _next(delta: np.ndarray, accepting: np.ndarray, budget: CompileBudget) -> Dfa:
    """Return the automaton of X; it is minimal if the operand is minimal.

    X f means: there is a next step, and f accepts the rest from there.
    """
    budget.spend_cells(delta.size)
    n, width = delta.shape
    budget.check_states(n)
    # The rest must not be empty, so it begins in a copy of state 0 that does not accept.
    (rest,) = np.nonzero((delta == delta[0]).all(axis=1) & ~accepting)
    if not len(rest):
        delta, accepting, rest = np.vstack([delta, delta[0]]), np.append(accepting, False), [n]
    (front,) = np.nonzero((delta == rest[0]).all(axis=1) & ~accepting)
    if not len(front):
        row = np.full(width, rest[0], np.int32)
        delta, accepting = np.vstack([delta, row]), np.append(accepting, False)
        front = [len(delta) - 1]
    # The front state becomes state 0: exchange both.
    swapped = np.arange(len(delta), dtype=np.int32)
    swapped[[0, front[0]]] = front[0], 0
    return swapped[delta[swapped]], accepting[swapped]


def _product(op: str, a: Dfa, b: Dfa, budget: CompileBudget) -> Dfa:
    """Return the reachable product of two automata over the same propositions."""
    (delta_a, accepts_a), (delta_b, accepts_b) = a, b
    width = len(delta_b)
    index = {0: 0}  # pair i * width + j of states of a and b → state of the product
    # Breadth-first: `pairs` has the new pairs of each level, `rows` their next states.
    rows, pairs = [], [np.zeros(1, np.int64)]
    while len(pairs[-1]):
        i, j = np.divmod(pairs[-1], width)
        budget.spend_cells(len(i) * delta_a.shape[1])
        targets = delta_a[i].astype(np.int64) * width + delta_b[j]
        distinct, place = np.unique(targets, return_inverse=True)
        known = len(index)
        states = [index.setdefault(pair, len(index)) for pair in distinct.tolist()]
        budget.check_states(len(index))
        number = np.array(states, np.int32)
        rows.append(number[place.reshape(targets.shape)])
        pairs.append(distinct[number >= known])
    i, j = np.divmod(np.concatenate(pairs), width)
    return np.concatenate(rows), _TABLES[op](accepts_a[i], accepts_b[j])


Alternative = tuple[tuple[int, ...], int]  # states of a, which must all accept, and a state of b


class _Until:
    """Subset construction of a U b: b may have begun at any step so far.

    A state has two parts. The first is the set of states of a that must still accept until b
    begins, None if it is too late for that. The second is the set of alternatives in which b has
    begun. Alternatives that another one includes are left out, so there are few.
    """

    def __init__(self, a: Dfa, b: Dfa, budget: CompileBudget) -> None:
        self._a, self._b, self._budget = a[0].tolist(), b[0].tolist(), budget
        self._a_accepts, self._b_accepts = a[1].tolist(), b[1].tolist()
        self._included_in_a, self._included_in_b = _Inclusion(*a, budget), _Inclusion(*b, budget)
        self._a_all, self._a_none = _find_sinks(*a)
        self._b_none = _find_sinks(*b)[1]
        self._width = a[0].shape[1]

    def automaton(self) -> Dfa:
        """Return the reachable states, breadth-first."""
        states: list[tuple[tuple[int, ...] | None, tuple[Alternative, ...]]] = [((), ())]
        index = {states[0]: 0}
        rows, accepting = [], []
        for waiting, alternatives in states:
            row = []
            for column in range(self._width):
                self._budget.spend(_PER_ALTERNATIVE * (1 + len(alternatives)))
                state = self._step(waiting, alternatives, column)
                if state not in index:
                    index[state] = len(states)
                    states.append(state)
                    self._budget.check_states(len(states))
                row.append(index[state])
            rows.append(row)
            accepting.append(any(map(self._accepts, alternatives)))
        return np.array(rows, np.int32), np.array(accepting)

    def _step(
        self, waiting: tuple[int, ...] | None, alternatives: Sequence[Alternative], column: int
    ) -> tuple[tuple[int, ...] | None, tuple[Alternative, ...]]:
        """Return the state after the step of a column of delta; see the class."""
        # b may begin with this step, unless it is too late.
        begun = [*alternatives] if waiting is None else [*alternatives, (waiting, 0)]
        moved: list[Alternative] = []
        for held, state in begun:
            still, to = self._advance_held(held, column), self._b[state][column]
            if still is not None and to != self._b_none:
                moved.append((still, to))
        if waiting is not None:
            waiting = self._advance_held((*waiting, 0), column)
        return waiting, self._widest(moved)

    def _advance_held(self, states: Sequence[int], column: int) -> tuple[int, ...] | None:
        """Return the states of a after a step; None if one of them can never accept."""
        moved = sorted({self._a[state][column] for state in states} - {self._a_all})
        if self._a_none in moved:
            return None
        self._budget.spend(len(moved) ** 2)
        # Leave out a state that accepts all that another one accepts, since both must accept.
        return tuple(
            s for s in moved if not any(t != s and self._included_in_a(t, s) for t in moved)
        )

    def _widest(self, alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
        """Return the alternatives that no other one includes."""
        kept = sorted(set(alternatives))
        self._budget.spend(len(kept) ** 2)
        return tuple(x for x in kept if not any(y != x and self._is_included(x, y) for y in kept))

    def _is_included(self, x: Alternative, y: Alternative) -> bool:
        """Return True if y certainly accepts all that x accepts (a sufficient test by parts)."""
        return self._included_in_b(x[1], y[1]) and all(
            any(self._included_in_a(s, t) for s in x[0]) for t in y[0]
        )

    def _accepts(self, alternative: Alternative) -> bool:
        held, state = alternative
        return self._b_accepts[state] and all(self._a_accepts[s] for s in held)


def _find_sinks(delta: np.ndarray, accepting: np.ndarray) -> tuple[int, int]:
    """Return the states that accept everything and nothing; -1 if there is none."""
    stays = (delta == np.arange(len(delta))[:, None]).all(axis=1)
    found = [np.flatnonzero(stays & (accepting == wanted)) for wanted in (True, False)]
    return tuple(int(states[0]) if len(states) else -1 for states in found)


class _Inclusion:
    """Language inclusion between states of an automaton, computed on demand."""

    def __init__(self, delta: np.ndarray, accepting: np.ndarray, budget: CompileBudget) -> None:
        self._rows, self._accepts, self._budget = delta.tolist(), accepting.tolist(), budget
        self._known: dict[tuple[int, int], bool] = {}

    def __call__(self, s: int, t: int) -> bool:
        """Return True if state t accepts everything that s accepts.

        The search looks for a trace to a pair of states of which only the first accepts.
        """
        if s == t:
            return True
        if self._known.get((t, s)):
            return False  # different states of a minimal automaton accept different traces
        if (s, t) not in self._known:
            self._seek((s, t))
        return self._known[s, t]

    def _seek(self, start: tuple[int, int]) -> None:
        """Decide the inclusion for a pair of states, and for all pairs on the way."""
        came_from: dict[tuple[int, int], tuple[int, int] | None] = {start: None}
        pairs = [start]
        for pair in pairs:
            s, t = pair
            self._budget.spend(2 * len(self._rows[s]))
            if self._known.get(pair) is False or (self._accepts[s] and not self._accepts[t]):
                while pair is not None:
                    self._known[pair] = False
                    pair = came_from[pair]
                return
            for after in zip(self._rows[s], self._rows[t], strict=True):
                known = after[0] == after[1] or self._known.get(after, False)
                if not known and after not in came_from:
                    came_from[after] = pair
                    pairs.append(after)
        self._known |= dict.fromkeys(came_from, True)


def minimise(delta: np.ndarray, accepting: np.ndarray, budget: CompileBudget) -> Dfa:
    """Return the automaton with equivalent states merged by partition refinement (Moore).

    Only reachable states stay; they are numbered breadth-first, propositions in their order.
    """
    n = len(delta)
    # Number of each state's block, and the number of blocks: first one or two, by acceptance.
    block, count = accepting.astype(np.int64), int(accepting.max()) + int(not accepting.all())
    while count < n:
        budget.spend_cells((n + _CALL_CELLS) * delta.shape[1])
        # Pack as many columns as fit into one int64, because it sorts fast.
        key, size = block, count
        for column in delta.T:
            if size * count >= 2**62:
                key, size = _number_from_zero(key)
            key, size = key * count + block[column], size * count
        finer, new_count = _number_from_zero(key)
        if new_count == count:
            break
        block, count = finer, new_count
    block = _number_from_zero(block)[0]
    _, first = np.unique(block, return_index=True)
    return _renumber(block[delta[first]], accepting[first], int(block[0]))


def _number_from_zero(key: np.ndarray) -> tuple[np.ndarray, int]:
    """Replace keys by numbers from 0, in order of the keys; return the numbers and their count."""
    values, dense = np.unique(key, return_inverse=True)
    return dense.reshape(-1), len(values)


def _renumber(delta: np.ndarray, accepting: np.ndarray, start: int) -> Dfa:
    """Return the states that are reachable from `start`, numbered breadth-first."""
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
