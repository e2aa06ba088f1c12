"""Our own compiler: every operator makes a minimal automaton of its operands' minimal automata.

Automata are pairs of delta (n, letters + 1) int32, NOTHING last, and accepting (n,) bool; they are
complete, and state 0 is initial. ! flips what accepts, & | -> <-> are products, X puts a state in
front, and U is a subset construction. All other operators are these:

    F b = true U b        G b = !F !b               WX a = !X !a
    a M b = b U (a & b)   a W b = !(!b U !(a | b))  a R b = !(!a U !b)

Where p is about the next letter alone, and g holds before wherever it holds later, as F does, the
first p will do: F (p & g) = !p U (p & g), whose subsets are single states.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import reduce

import numpy as np

from edge.mission.logic.limits import PER_NODE, CompileError, Effort
from edge.mission.logic.ltl import Formula, postorder

Dfa = tuple[np.ndarray, np.ndarray]
Key = tuple[str, tuple[int, ...], str]  # an operator, its operands' numbers, a proposition

# So many subformulas bound the memory of a compilation.
MAX_NODES = 10_000
# As many cells take as long as calling NumPy for one column does.
_CALL = 500
_PER_ALTERNATIVE = 16  # steps of moving one on by a letter

_TABLES = {
    "&": np.logical_and,
    "|": np.logical_or,
    "->": lambda a, b: ~a | b,
    "<->": lambda a, b: a == b,
}


def language(formula: Formula, letters: Sequence[str], effort: Effort) -> Dfa:
    """The minimal complete automaton of a formula over given letters and NOTHING.

    Args:
        letters: distinct; at least the propositions of the formula.

    Returns:
        See the module; states are numbered breadth-first.

    Raises:
        CompileError: a limit was passed.
    """
    nodes = _nodes(formula, effort)
    uses = Counter(arg for _, args, _ in nodes for arg in args)
    column = {name: k for k, name in enumerate(letters)}
    made: dict[int, Dfa] = {}
    for number, (op, args, name) in enumerate(nodes):
        effort.spend(PER_NODE * (1 + len(args)))
        if op == "ap":
            made[number] = _reached(column[name], len(letters) + 1)
        elif not args:
            made[number] = np.zeros((1, len(letters) + 1), np.int32), np.array([op == "true"])
        else:
            made[number] = _made(op, [made[arg] for arg in args], effort)
        uses.subtract(args)
        for arg in {arg for arg in args if not uses[arg]}:
            del made[arg]
    return minimal(*made[len(nodes) - 1], effort)


def _nodes(formula: Formula, effort: Effort) -> list[Key]:
    """The different subformulas, operands before operators, in the operators that are made."""
    nodes = _Nodes()
    known: dict[int, int] = {}
    for f in postorder(formula):
        effort.spend(PER_NODE)
        known[id(f)] = nodes.reduced(f, [known[id(arg)] for arg in f.args])
    return nodes.keys[: known[id(formula)] + 1]


class _Nodes:
    """Numbers subformulas in the order in which they are met, equal ones alike."""

    def __init__(self) -> None:
        self.keys: list[Key] = []
        self._numbers: dict[Key, int] = {}
        self._negated: dict[int, int] = {}
        self._of_next: set[int] = set()  # about the next letter alone
        self._early: set[int] = set()  # that hold before wherever they hold later

    def number(self, op: str, *args: int, name: str = "") -> int:
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
        """F b; see the module."""
        op, parts, _ = self.keys[b]
        before = self.number("true")
        first = [part for part in parts if part in self._of_next]
        if op == "&" and first and self._early.issuperset({*parts} - {*first}):
            before = self.number("!", self.number("&", *first) if first[1:] else first[0])
        found = self.number("U", before, b)
        self._early.add(found)
        return found

    def reduced(self, f: Formula, args: list[int]) -> int:
        """The number of a subformula, its operator put as the module says."""
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


def _reached(letter: int, width: int) -> Dfa:
    """The first letter is this one."""
    delta = np.full((3, width), 2, np.int32)
    delta[0, letter] = delta[1] = 1
    return delta, np.array([False, True, False])


def _made(op: str, args: list[Dfa], effort: Effort) -> Dfa:
    """The minimal automaton of an operator, but for the order of its states."""
    match op:
        case "!":
            return args[0][0], ~args[0][1]
        case "X":
            return _next(*args[0], effort)
        case "U":
            return minimal(*_Until(*args, effort).automaton(), effort)
        case "&" | "|":  # the small ones first, so that what is thrown away was small
            args = sorted(args, key=lambda dfa: len(dfa[0]))
    return reduce(lambda a, b: minimal(*_product(op, a, b, effort), effort), args)


def _next(delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> Dfa:
    """There is a next step, and the rest from it on is accepted: minimal as what it is made of."""
    effort.spend_cells(delta.size)
    n, width = delta.shape
    effort.check_states(n)
    # The rest must have a letter, so it begins in a state that is like 0 but does not accept.
    (rest,) = np.nonzero((delta == delta[0]).all(axis=1) & ~accepting)
    if not len(rest):
        delta, accepting, rest = np.vstack([delta, delta[0]]), np.append(accepting, False), [n]
    (front,) = np.nonzero((delta == rest[0]).all(axis=1) & ~accepting)
    if not len(front):
        row = np.full(width, rest[0], np.int32)
        delta, accepting = np.vstack([delta, row]), np.append(accepting, False)
        front = [len(delta) - 1]
    swapped = np.arange(len(delta), dtype=np.int32)
    swapped[[0, front[0]]] = front[0], 0
    return swapped[delta[swapped]], accepting[swapped]


def _product(op: str, a: Dfa, b: Dfa, effort: Effort) -> Dfa:
    """The reachable product of two automata over the same letters."""
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
    return np.concatenate(rows), _TABLES[op](accepts_a[i], accepts_b[j])


Alternative = tuple[tuple[int, ...], int]  # states of a, all of which must accept, and one of b


class _Until:
    """a U b by subsets: b may have begun to hold at any of the steps so far.

    A state is what a must still accept until b begins, None where that is too late, and the
    alternatives of having begun. What an alternative accepts another may accept as well: then it
    is left out, which keeps their number small.
    """

    def __init__(self, a: Dfa, b: Dfa, effort: Effort) -> None:
        self._a, self._b, self._effort = a[0].tolist(), b[0].tolist(), effort
        self._a_accepts, self._b_accepts = a[1].tolist(), b[1].tolist()
        self._under_a, self._under_b = _Inclusion(*a, effort), _Inclusion(*b, effort)
        self._a_all, self._a_none = _sinks(*a)
        self._b_none = _sinks(*b)[1]
        self._width = a[0].shape[1]

    def automaton(self) -> Dfa:
        """The states that can be reached, breadth-first."""
        states: list[tuple[tuple[int, ...] | None, tuple[Alternative, ...]]] = [((), ())]
        index = {states[0]: 0}
        rows, accepting = [], []
        for waiting, alternatives in states:
            row = []
            for letter in range(self._width):
                self._effort.spend(_PER_ALTERNATIVE * (1 + len(alternatives)))
                state = self._step(waiting, alternatives, letter)
                if state not in index:
                    index[state] = len(states)
                    states.append(state)
                    self._effort.check_states(len(states))
                row.append(index[state])
            rows.append(row)
            accepting.append(any(map(self._accepts, alternatives)))
        return np.array(rows, np.int32), np.array(accepting)

    def _step(
        self, waiting: tuple[int, ...] | None, alternatives: Sequence[Alternative], letter: int
    ) -> tuple[tuple[int, ...] | None, tuple[Alternative, ...]]:
        begun = [*alternatives] if waiting is None else [*alternatives, (waiting, 0)]
        moved: list[Alternative] = []
        for held, state in begun:
            still, to = self._held(held, letter), self._b[state][letter]
            if still is not None and to != self._b_none:
                moved.append((still, to))
        if waiting is not None:
            waiting = self._held((*waiting, 0), letter)
        return waiting, self._widest(moved)

    def _held(self, states: Sequence[int], letter: int) -> tuple[int, ...] | None:
        """What states of a are after a letter; None where one accepts nothing any more."""
        moved = sorted({self._a[state][letter] for state in states} - {self._a_all})
        if self._a_none in moved:
            return None
        self._effort.spend(len(moved) ** 2)
        return tuple(s for s in moved if not any(t != s and self._under_a(t, s) for t in moved))

    def _widest(self, alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
        """Those that no other one includes."""
        kept = sorted(set(alternatives))
        self._effort.spend(len(kept) ** 2)
        return tuple(x for x in kept if not any(y != x and self._under(x, y) for y in kept))

    def _under(self, x: Alternative, y: Alternative) -> bool:
        """Whether y accepts all that x does, as far as its parts tell."""
        return self._under_b(x[1], y[1]) and all(
            any(self._under_a(s, t) for s in x[0]) for t in y[0]
        )

    def _accepts(self, alternative: Alternative) -> bool:
        held, state = alternative
        return self._b_accepts[state] and all(self._a_accepts[s] for s in held)


def _sinks(delta: np.ndarray, accepting: np.ndarray) -> tuple[int, int]:
    """The states that accept everything and nothing; -1 for none."""
    stays = (delta == np.arange(len(delta))[:, None]).all(axis=1)
    found = [np.flatnonzero(stays & (accepting == wanted)) for wanted in (True, False)]
    return tuple(int(states[0]) if len(states) else -1 for states in found)


class _Inclusion:
    """Whether one state of an automaton accepts no more than another; found where it is asked."""

    def __init__(self, delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> None:
        self._rows, self._accepts, self._effort = delta.tolist(), accepting.tolist(), effort
        self._known: dict[tuple[int, int], bool] = {}

    def __call__(self, s: int, t: int) -> bool:
        """Whether t accepts all that s does: no word leads to a pair of which only s accepts."""
        if s == t:
            return True
        if self._known.get((t, s)):
            return False  # no two states of a minimal automaton accept the same
        if (s, t) not in self._known:
            self._seek((s, t))
        return self._known[s, t]

    def _seek(self, start: tuple[int, int]) -> None:
        came_from: dict[tuple[int, int], tuple[int, int] | None] = {start: None}
        pairs = [start]
        for pair in pairs:
            s, t = pair
            self._effort.spend(2 * len(self._rows[s]))
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


def minimal(delta: np.ndarray, accepting: np.ndarray, effort: Effort) -> Dfa:
    """Merge equivalent states by partition refinement (Moore).

    States that can be reached are numbered breadth-first, letters in their order.
    """
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
    block = _dense(block)[0]
    _, first = np.unique(block, return_index=True)
    return _numbered(block[delta[first]], accepting[first], int(block[0]))


def _dense(key: np.ndarray) -> tuple[np.ndarray, int]:
    values, dense = np.unique(key, return_inverse=True)
    return dense.reshape(-1), len(values)


def _numbered(delta: np.ndarray, accepting: np.ndarray, start: int) -> Dfa:
    """The states that can be reached from one, numbered breadth-first."""
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
