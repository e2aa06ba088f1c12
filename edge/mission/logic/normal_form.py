"""What a formula leaves to the rest of a word, once a letter was read.

That is a monotone Boolean function of finitely many *atoms*: nodes with a temporal operator,
and literals that wait behind a next. It is kept as its prime implicants, so that equal
functions are equal tuples. Where an atom implies another (F (a & F b) implies F b), implicants
are thinned out by that too, which saves many states; a few equal functions may then differ,
and are merged when the automaton is made minimal.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import reduce
from operator import or_

from edge.mission.logic.limits import PER_NODE, CompileError, Limits
from edge.mission.logic.nnf import RELATED_NODES, Nodes

# Prime implicants in ascending order, each an int with a bit per atom's node number.
Dnf = tuple[int, ...]
FALSE: Dnf = ()
TRUE: Dnf = (0,)


class TooWide(CompileError):
    """A function has more prime implicants than were allowed."""


class Rewriter:
    """Rewrites nodes over letters, and remembers what it did.

    Attributes:
        nodes: what is rewritten.
        nothing: the number of the letter NOTHING, one more than the last proposition's.
        max_clauses: the most prime implicants a function may have, if there is a limit.
        per_implicant: steps of making one, besides comparing it with others.
    """

    def __init__(self, nodes: Nodes, nothing: int, limits: Limits, max_clauses: int | None) -> None:
        self.nodes = nodes
        self.nothing = nothing
        self.max_clauses = max_clauses
        self._limits = limits
        # Implicants are as wide as there are nodes, and wide ones take longer to move about.
        self.per_implicant = 8 + len(nodes.kind) // 128
        self._now: dict[int, Dnf] = {}
        self._after: dict[tuple[int, int], Dnf] = {}
        self._entailed: dict[int, int] = {}
        self._reduced: dict[int, tuple[int, int]] = {}

    def now(self, root: int) -> Dnf:
        """A node as a function of the atoms."""
        done, stack = self._now, [root]
        while stack:
            node = stack[-1]
            kind = self.nodes.kind[node]
            inner = self.nodes.args[node] if kind in ("&", "|") else ()
            self._limits.spend(PER_NODE * (1 + len(inner)))
            missing = [a for a in inner if a not in done]
            if missing:
                stack.extend(missing)
                continue
            stack.pop()
            if inner:
                done[node] = self.join(kind, [done[a] for a in inner])
            else:
                done[node] = TRUE if kind == "true" else FALSE if kind == "false" else (1 << node,)
        return done[root]

    def after(self, root: int, letter: int) -> Dnf:
        """What the rest must satisfy for `letter` and it together to satisfy a node."""
        done, nothing = self._after, self.nothing
        kinds, operands, support = self.nodes.kind, self.nodes.args, self.nodes.support
        # Letters that a node does not mention are all the same to it.
        whole = (root, letter if support[root] >> letter & 1 else nothing)
        stack = [] if whole in done else [whole]
        while stack:
            node, letter = key = stack[-1]
            depth, inner = len(stack), []
            of = operands[node] if kinds[node] in ("&", "|", "U", "R") else ()
            self._limits.spend(PER_NODE * (1 + len(of)))
            for a in of:
                part = (a, letter if support[a] >> letter & 1 else nothing)
                value = done.get(part)
                if value is None and kinds[a] == "lit":
                    value = done[part] = self._progress(a, letter, [])
                if value is None:
                    stack.append(part)
                else:
                    inner.append(value)
            if len(stack) == depth:
                done[key] = self._progress(node, letter, inner)
                stack.pop()
        return done[whole]

    def join(self, op: str, parts: Sequence[Dnf]) -> Dnf:
        """The conjunction or disjunction of functions."""
        if op == "|":
            return TRUE if TRUE in parts else self.primes({c for part in parts for c in part})
        if FALSE in parts:
            return FALSE
        result = TRUE
        for part in sorted(parts, key=len):
            result = part if result == TRUE else self._both(result, part)
        return result

    def primes(self, implicants: Collection[int]) -> Dnf:
        """Those of distinct implicants that imply no other."""
        if len(implicants) < 2:
            return tuple(self._reduce(c)[0] if self.nodes.related else c for c in implicants)
        kept = self._weakest(implicants) if self.nodes.related else self._smallest(implicants)
        kept.sort()
        return tuple(kept)

    def _smallest(self, implicants: Collection[int]) -> list[int]:
        """`primes` where no atom implies another: implicants that contain no other."""
        by_size: dict[int, list[int]] = {}
        for c in implicants:
            by_size.setdefault(c.bit_count(), []).append(c)
        kept: list[int] = []
        for size in sorted(by_size):  # of one size, none can contain another
            smaller = kept.copy()
            for c in by_size[size]:
                compared = next((n for n, k in enumerate(smaller, 1) if k & c == k), 0)
                self._limits.spend(self.per_implicant + (compared or len(smaller)))
                if not compared:
                    kept.append(c)
            self._check_width(kept)
        return kept

    def _weakest(self, implicants: Collection[int]) -> list[int]:
        kept: dict[int, int] = {}
        for n, c in enumerate(sorted(implicants)):
            self._limits.spend(self.per_implicant + 2 * len(kept))
            if n % 64 == 63:
                self._check_width(kept)
            least, closed = self._reduced.get(c) or self._reduce(c)
            if any(k & closed == k for k in kept):
                continue
            for k in [k for k, implied in kept.items() if least & implied == least]:
                del kept[k]
            kept[least] = closed
        self._check_width(kept)
        return list(kept)

    def _check_width(self, kept: Collection[int]) -> None:
        if self.max_clauses is not None and len(kept) > self.max_clauses:
            raise TooWide("formula: too many alternatives; use fewer")

    def _both(self, a: Dnf, b: Dnf) -> Dnf:
        products: set[int] = set()
        for x in a:
            self._limits.spend(self.per_implicant * len(b))
            products.update([x | y for y in b])
        return self.primes(products)

    def _progress(self, node: int, letter: int, inner: list[Dnf]) -> Dnf:
        kind, args = self.nodes.kind[node], self.nodes.args[node]
        if kind == "lit":
            return TRUE if (args[0] == letter) == args[1] else FALSE
        if kind == "U":
            left, right = inner
            if right == TRUE or left == FALSE:
                return right
            again = (1 << node,) if left == TRUE else self._both(left, (1 << node,))
            return self.join("|", [right, again]) if right else again
        if kind == "R":
            left, right = inner
            if right == FALSE or left == TRUE:
                return right
            return self.join("&", [right, self.join("|", [left, (1 << node,)])])
        if kind in ("&", "|"):
            return self.join(kind, inner)
        if kind == "X":  # there must be a rest, and it satisfies the operand
            return self.join("&", [self.now(args[0]), self.now(self.nodes.some())])
        if kind == "WX":
            return self.join("|", [self.now(args[0]), self.now(self.nodes.none())])
        return TRUE if kind == "true" else FALSE

    def _entails(self, atom: int) -> int:
        """All atoms that an atom is known to imply, itself among them, as bits."""
        entailed = self._entailed.get(atom)
        if entailed is None:
            entailed, todo = 0, 1 << atom
            while todo:
                self._limits.spend(todo.bit_count())
                entailed |= todo
                found = [self.nodes.implied[a] for a in bits(todo) if a < RELATED_NODES]
                todo = reduce(or_, found, 0) & ~entailed
            self._entailed[atom] = entailed
        return entailed

    def _reduce(self, implicant: int) -> tuple[int, int]:
        """An implicant without atoms that its others imply; and all that it implies."""
        found = self._reduced.get(implicant)
        if found is None:
            self._limits.spend(implicant.bit_count())
            least, closed = implicant, 0
            for atom in bits(implicant):
                if least >> atom & 1:
                    entailed = self._entails(atom)
                    least &= ~entailed | 1 << atom
                    closed |= entailed
            found = self._reduced[implicant] = (least, closed)
        return found


def bits(mask: int) -> Iterator[int]:
    """The positions of the ones, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low
