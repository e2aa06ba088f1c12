"""What a formula leaves to the rest of a word, once a letter was read.

That is a monotone Boolean function of finitely many *atoms*: nodes with a temporal operator,
and literals that wait behind a next. It is kept as its prime implicants, so that equal
functions are equal tuples. Where an atom implies another (F (a & F b) implies F b), implicants
are thinned out by that too, which saves many states; a few equal functions may then differ,
and are merged when the automaton is made minimal.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import reduce
from operator import and_, or_

from edge.mission.logic.limits import PER_NODE, CompileError, Effort
from edge.mission.ltl import Formula

_DUAL = {
    "true": "false", "false": "true", "&": "|", "|": "&", "X": "WX", "WX": "X", "F": "G",
    "G": "F", "U": "R", "R": "U", "W": "M", "M": "W",
}  # fmt: skip
# Implications are sought among so many nodes; beyond, they would take more than they save.
RELATED_NODES = 4096
# States are as wide as there are nodes, so this also bounds the memory of a compilation.
MAX_NODES = 10_000


class Nodes:
    """Negation normal form of a formula, as numbered nodes that equal subformulas share.

    Nodes are "lit", "X", "WX", "&", "|", "true", "false", and two temporal kinds that the rest of
    the operators reduce to, strong until (U) and weak release (R):
        F b = true U b     a U b = b | (a & X (a U b))      a M b = b U (a & b)
        G b = false R b    a R b = b & (a | WX (a R b))     a W b = b R (a | b)

    Raises:
        CompileError: there are more than `MAX_NODES`, or a limit was passed.

    Attributes:
        root: the node of the formula itself.
        kind, args: per node, as above; args are node numbers, but (letter, wanted truth)
            of a literal.
        support: per node, the letters it mentions, as bits.
        at_end: per node, whether the empty word satisfies it.
        implied: per node, other temporal nodes that hold of every word of which it does, as
            bits: those that are cheap to find.
        related: whether any temporal node implies another.
    """

    def __init__(self, formula: Formula, letters: Sequence[str], effort: Effort) -> None:
        self.kind: list[str] = []
        self.args: list[tuple] = []
        self.support: list[int] = []
        self.at_end: list[bool] = []
        self.implied: list[int] = []
        self.related = False
        self._eventual = 0  # nodes F g, as bits
        self._true_at_end = 0  # temporal nodes that the empty word satisfies, as bits
        self._ids: dict[tuple, int] = {}
        self._column = {name: k for k, name in enumerate(letters)}
        self._false, self._true = self.node("false", ()), self.node("true", ())
        self.root = self._translate(formula, effort)

    def some(self) -> int:
        """F true: the word is not empty."""
        return self.node("U", (self._true, self._true))

    def none(self) -> int:
        """G false: the word is empty."""
        return self.node("R", (self._false, self._false))

    def _translate(self, formula: Formula, effort: Effort) -> int:
        # Formulas are told apart by identity: they all live as long as the root does.
        done: dict[tuple[int, bool], int] = {}
        stack = [(formula, True)]
        while stack:
            f, wanted = stack[-1]
            inner = _operands(f, wanted)
            effort.spend(PER_NODE * (1 + len(inner)))
            missing = [(g, w) for g, w in inner if (id(g), w) not in done]
            if missing:
                stack.extend(missing)
                continue
            stack.pop()
            nodes = [done[id(g), w] for g, w in inner]
            done[id(f), wanted] = self._build(f, wanted, nodes)
        return done[id(formula), True]

    def _build(self, f: Formula, wanted: bool, args: list[int]) -> int:
        if f.op == "ap":
            return self.node("lit", (self._column[f.name], wanted))
        if f.op == "!":
            return args[0]
        if f.op == "->":
            return self._boolean("|" if wanted else "&", args)
        if f.op == "<->":
            either = [self._boolean("&", args[:2]), self._boolean("&", args[2:])]
            return self._boolean("|", either)
        op = f.op if wanted else _DUAL[f.op]
        if op in ("&", "|"):
            return self._boolean(op, args)
        match op:
            case "F":
                return self._again("U", (self._true, args[0]))
            case "G":
                return self._again("R", (self._false, args[0]))
            case "W":
                return self.node("R", (args[1], self._boolean("|", args)))
            case "M":
                return self.node("U", (args[1], self._boolean("&", args)))
        return self.node(op, tuple(args))

    def _again(self, kind: str, args: tuple[int, int]) -> int:
        """F g or G g; F F g is F g, and G G g is G g."""
        inner = args[1]
        same = self.kind[inner] == kind and self.args[inner][0] == args[0]
        return inner if same else self.node(kind, args)

    def _boolean(self, op: str, args: Iterable[int]) -> int:
        zero, one = (self._false, self._true) if op == "&" else (self._true, self._false)
        distinct = dict.fromkeys(a for a in args if a != one)
        if zero in distinct:
            return zero
        if len(distinct) < 2:
            return next(iter(distinct), one)
        return self.node(op, tuple(distinct))

    def node(self, kind: str, args: tuple) -> int:
        """The number of a node, made if there is none yet."""
        node = self._ids.get((kind, args))
        if node is None:
            node = self._ids[kind, args] = len(self.kind)
            if node >= MAX_NODES:
                raise CompileError(
                    f"formula: more than {MAX_NODES} different subformulas; make it shorter"
                )
            self.kind.append(kind)
            self.args.append(args)
            self.support.append(self._support(kind, args))
            self.at_end.append(self._at_end(kind, args))
            self.implied.append(self._implications(node, kind, args))
        return node

    def _support(self, kind: str, args: tuple) -> int:
        if kind == "lit":
            return 1 << args[0]
        return reduce(or_, [self.support[a] for a in args], 0)

    def _at_end(self, kind: str, args: tuple) -> bool:
        if kind == "lit":
            return not args[1]
        if kind == "&":
            return all(self.at_end[a] for a in args)
        if kind == "|":
            return any(self.at_end[a] for a in args)
        return kind in ("true", "WX", "R")

    def _implications(self, node: int, kind: str, args: tuple) -> int:
        if node >= RELATED_NODES:
            return 0
        if kind == "&":
            return reduce(or_, [self.implied[a] for a in args])
        if kind == "|":
            return reduce(and_, [self.implied[a] for a in args])
        if kind in ("true", "false", "lit"):  # literals are atoms only behind a next
            return 0
        bit = own = 1 << node
        if self.at_end[node]:
            self._true_at_end |= bit
        if kind == "U":
            left, right = args
            if left == self._true:
                self._eventual |= bit
            own |= self.implied[right] & self._eventual  # F g later is F g now
            if self.kind[right] == "U":  # b is a U b already, and false of the empty word too
                self.implied[right] |= bit
                self.related = True
        if kind == "R":  # b holds now, except of the empty word
            own |= self.implied[args[1]] & self._true_at_end
        self.related |= own != bit
        return own


def _operands(f: Formula, wanted: bool) -> list[tuple[Formula, bool]]:
    """What must be translated, and with which truth, before f itself can be."""
    if f.op == "!":
        return [(f.args[0], not wanted)]
    if f.op == "->":
        return [(f.args[0], not wanted), (f.args[1], wanted)]
    if f.op == "<->":
        a, b = f.args
        return [(a, True), (b, wanted), (a, False), (b, not wanted)]
    return [(arg, wanted) for arg in f.args]


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

    def __init__(self, nodes: Nodes, nothing: int, effort: Effort, max_clauses: int | None) -> None:
        self.nodes = nodes
        self.nothing = nothing
        self.max_clauses = max_clauses
        self._effort = effort
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
            self._effort.spend(PER_NODE * (1 + len(inner)))
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
            self._effort.spend(PER_NODE * (1 + len(of)))
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
                self._effort.spend(self.per_implicant + (compared or len(smaller)))
                if not compared:
                    kept.append(c)
            self._check_width(kept)
        return kept

    def _weakest(self, implicants: Collection[int]) -> list[int]:
        kept: dict[int, int] = {}
        for n, c in enumerate(sorted(implicants)):
            self._effort.spend(self.per_implicant + 2 * len(kept))
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
            self._effort.spend(self.per_implicant * len(b))
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
                self._effort.spend(todo.bit_count())
                entailed |= todo
                found = [self.nodes.implied[a] for a in bits(todo) if a < RELATED_NODES]
                todo = reduce(or_, found, 0) & ~entailed
            self._entailed[atom] = entailed
        return entailed

    def _reduce(self, implicant: int) -> tuple[int, int]:
        """An implicant without atoms that its others imply; and all that it implies."""
        found = self._reduced.get(implicant)
        if found is None:
            self._effort.spend(implicant.bit_count())
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
