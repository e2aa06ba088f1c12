"""Formulas of linear temporal logic over finite words: the tree, its constructors, its text.

Nothing here recurses, so a formula may be nested as deep as memory allows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

WORD = r"[A-Za-z_][A-Za-z0-9_]*"
UNARY = ("!", "X", "WX", "F", "G")
# Binding strength, weakest first; U W R M share one level.
STRENGTH = {"<->": 1, "->": 2, "|": 3, "&": 4, "U": 5, "W": 5, "R": 5, "M": 5}
STRENGTH |= dict.fromkeys(UNARY, 6)
KEYWORDS = frozenset({"X", "WX", "F", "G", "U", "W", "R", "M", "true", "false"})
_ATOM_STRENGTH = 7


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Formula:
    """One operator and its operands; equal when the trees are equal.

    Attributes:
        op: "true", "false", "ap" (a proposition), "!", "&", "|", "->", "<->", "X", "WX" (strong
            and weak next), "F", "G", "U", "W" (strong and weak until), "R" or "M" (weak and
            strong release).
        args: operands; & and | have two or more, and none of their own kind.
        name: the proposition's name, of "ap" only.
    """

    op: str
    args: tuple[Formula, ...] = ()
    name: str = ""
    _hash: list[int] = field(default_factory=list, init=False)

    def __hash__(self) -> int:
        if not self._hash:
            for f in postorder(self):
                if not f._hash:
                    f._hash.append(hash((f.op, f.name, *(arg._hash[0] for arg in f.args))))
        return self._hash[0]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Formula):
            return NotImplemented
        if hash(self) != hash(other):
            return False
        pairs, same = [(self, other)], set()
        while pairs:
            a, b = pairs.pop()
            if a is b or (id(a), id(b)) in same:
                continue
            if a._hash != b._hash or a.op != b.op or a.name != b.name or len(a.args) != len(b.args):
                return False
            same.add((id(a), id(b)))
            pairs.extend(zip(a.args, b.args, strict=True))
        return True

    def __str__(self) -> str:
        return to_text(self)

    def __repr__(self) -> str:
        return f"<Formula {to_text(self)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _from_postfix, ([(f.op, len(f.args), f.name) for f in _as_tree(self)],)


TRUE = Formula("true")
FALSE = Formula("false")


def ap(name: str) -> Formula:
    """The proposition "`name` is reached in this step"; the name must not be blank."""
    if not name.strip():
        raise ValueError("a proposition needs a name")
    return Formula("ap", (), name)


def neg(f: Formula) -> Formula:
    """!f"""
    return Formula("!", (f,))


def conj(*fs: Formula) -> Formula:
    """f & g & …, nested conjunctions flattened; `true` of none, f itself of one."""
    return _nary("&", fs, TRUE)


def disj(*fs: Formula) -> Formula:
    """f | g | …, nested disjunctions flattened; `false` of none, f itself of one."""
    return _nary("|", fs, FALSE)


def implies(a: Formula, b: Formula) -> Formula:
    """a -> b"""
    return Formula("->", (a, b))


def iff(a: Formula, b: Formula) -> Formula:
    """a <-> b"""
    return Formula("<->", (a, b))


def next_(f: Formula) -> Formula:
    """X f: there is a next step, and f holds there."""
    return Formula("X", (f,))


def weak_next(f: Formula) -> Formula:
    """WX f: f holds at the next step, if there is one."""
    return Formula("WX", (f,))


def eventually(f: Formula) -> Formula:
    """F f: f holds now or at some later step."""
    return Formula("F", (f,))


def always(f: Formula) -> Formula:
    """G f: f holds now and at all later steps."""
    return Formula("G", (f,))


def until(a: Formula, b: Formula) -> Formula:
    """a U b: b holds at some step, and a at every step before it."""
    return Formula("U", (a, b))


def weak_until(a: Formula, b: Formula) -> Formula:
    """a W b: a U b, or a at every step ("not a until b" of speech is `!a W b`)."""
    return Formula("W", (a, b))


def release(a: Formula, b: Formula) -> Formula:
    """a R b: b holds up to and including the first step at which a does, if any."""
    return Formula("R", (a, b))


def strong_release(a: Formula, b: Formula) -> Formula:
    """a M b: a R b, and a does hold at some step."""
    return Formula("M", (a, b))


def postorder(f: Formula) -> Iterator[Formula]:
    """Every distinct object of the tree, operands before operators."""
    seen: set[int] = set()
    stack = [(f, False)]
    while stack:
        node, ready = stack.pop()
        if ready:
            yield node
        elif id(node) not in seen:
            seen.add(id(node))
            stack.append((node, True))
            stack.extend((arg, False) for arg in reversed(node.args))


def propositions(f: Formula) -> tuple[str, ...]:
    """The names in a formula, in order of first appearance."""
    return tuple(dict.fromkeys(node.name for node in postorder(f) if node.op == "ap"))


def to_text(f: Formula) -> str:
    """Infix text with no needless parentheses; `parse` gives the same formula back.

    >>> to_text(eventually(conj(disj(ap("chair"), ap("potted plant")), eventually(ap("tv")))))
    'F ((chair | "potted plant") & F tv)'
    """
    out: list[str] = []
    todo: list[Formula | str] = [f]
    while todo:
        item = todo.pop()
        if isinstance(item, str):
            out.append(item)
        else:
            todo.extend(reversed(_pieces(item)))
    return "".join(out)


def _pieces(f: Formula) -> list[Formula | str]:
    if f.op == "ap":
        return [_name(f.name)]
    if not f.args:
        return [f.op]
    own = STRENGTH[f.op]
    if f.op in UNARY:
        return [f.op if f.op == "!" else f.op + " ", *_operand(f.args[0], own)]
    pieces: list[Formula | str] = []
    last = len(f.args) - 1
    for k, arg in enumerate(f.args):
        # All but & and | associate to the right, so only a right operand may be of their level.
        right = k == last and f.op not in "&|"
        pieces += _operand(arg, own if right else own + 1)
        if k < last:
            pieces.append(f" {f.op} ")
    return pieces


def _operand(f: Formula, at_least: int) -> list[Formula | str]:
    return [f] if STRENGTH.get(f.op, _ATOM_STRENGTH) >= at_least else ["(", f, ")"]


def _name(name: str) -> str:
    if re.fullmatch(WORD, name) and name not in KEYWORDS:
        return name
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _nary(op: str, fs: tuple[Formula, ...], empty: Formula) -> Formula:
    flat: list[Formula] = []
    for f in fs:
        flat.extend(f.args if f.op == op else (f,))
    if len(flat) < 2:
        return flat[0] if flat else empty
    return Formula(op, tuple(flat))


def _as_tree(f: Formula) -> Iterator[Formula]:
    """Like `postorder`, but what occurs twice comes twice."""
    stack = [(f, False)]
    while stack:
        node, ready = stack.pop()
        if ready:
            yield node
        else:
            stack.append((node, True))
            stack.extend((arg, False) for arg in reversed(node.args))


def _from_postfix(nodes: list[tuple[str, int, str]]) -> Formula:
    done: list[Formula] = []
    for op, n, name in nodes:
        args = tuple(done[len(done) - n :])
        del done[len(done) - n :]
        done.append(Formula(op, args, name))
    return done[0]


BINARY: dict[str, Callable[[Formula, Formula], Formula]] = {
    "->": implies, "<->": iff, "&": conj, "|": disj,
    "U": until, "W": weak_until, "R": release, "M": strong_release,
}  # fmt: skip
