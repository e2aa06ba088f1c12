"""Negation normal form of a formula, as numbered nodes that equal subformulas share.

Nodes are "lit", "X", "WX", "&", "|", "true", "false", and two temporal kinds that the rest of
the operators reduce to, strong until (U) and weak release (R):
    F b = true U b     a U b = b | (a & X (a U b))      a M b = b U (a & b)
    G b = false R b    a R b = b & (a | WX (a R b))     a W b = b R (a | b)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import and_, or_

from edge.mission.logic.formula import Formula
from edge.mission.logic.limits import PER_NODE, CompileError, Limits

_DUAL = {
    "true": "false", "false": "true", "&": "|", "|": "&", "X": "WX", "WX": "X", "F": "G",
    "G": "F", "U": "R", "R": "U", "W": "M", "M": "W",
}  # fmt: skip
# Implications are sought among so many nodes; beyond, they would take more than they save.
RELATED_NODES = 4096
# States are as wide as there are nodes, so this also bounds the memory of a compilation.
MAX_NODES = 10_000


class Nodes:
    """The nodes of one formula.

    Raises:
        CompileError: there are more than `MAX_NODES`, or a limit was passed.

    Attributes:
        root: the node of the formula itself.
        kind, args: per node, see the module; args are node numbers, but (letter, wanted truth)
            of a literal.
        support: per node, the letters it mentions, as bits.
        at_end: per node, whether the empty word satisfies it.
        implied: per node, other temporal nodes that hold of every word of which it does, as
            bits: those that are cheap to find.
        related: whether any temporal node implies another.
    """

    def __init__(self, formula: Formula, letters: Sequence[str], limits: Limits) -> None:
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
        self.root = self._translate(formula, limits)

    def some(self) -> int:
        """F true: the word is not empty."""
        return self.node("U", (self._true, self._true))

    def none(self) -> int:
        """G false: the word is empty."""
        return self.node("R", (self._false, self._false))

    def _translate(self, formula: Formula, limits: Limits) -> int:
        # Formulas are told apart by identity: they all live as long as the root does.
        done: dict[tuple[int, bool], int] = {}
        stack = [(formula, True)]
        while stack:
            f, wanted = stack[-1]
            inner = _operands(f, wanted)
            limits.spend(PER_NODE * (1 + len(inner)))
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
