"""Linear temporal logic over finite traces (LTLf): formulas, their text, their meaning.

In each step of a trace, the robot reaches one object or nothing (ViTL IV-A). Semantics as in
De Giacomo and Vardi, "Linear temporal logic and linear dynamic logic on finite traces" (IJCAI
2013), extended to the empty trace: there a proposition, X, F, U and M are false; WX, G, R and W
are true; ! negates.

>>> parse("F ((chair | couch) & F tv)").args[0].op
'&'
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from edge import names
from edge.errors import UserError
from edge.text import one_line

WORD = r"[A-Za-z_][A-Za-z0-9_]*"
"""Regular expression for a proposition or an operator without quotes."""
UNARY = ("!", "X", "WX", "F", "G")
# Binding strength, weakest first; U W R M share one level.
STRENGTH = {"<->": 1, "->": 2, "|": 3, "&": 4, "U": 5, "W": 5, "R": 5, "M": 5}
STRENGTH |= dict.fromkeys(UNARY, 6)
# Words that are no propositions, unless in quotes.
KEYWORDS = frozenset({"X", "WX", "F", "G", "U", "W", "R", "M", "true", "false"})
_ATOM_STRENGTH = 7  # of a proposition or a constant: no parentheses


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Formula:
    """One operator and its operands; equal if the trees are equal.

    Attributes:
        op: "true", "false", "ap" (a proposition), "!", "&", "|", "->", "<->", "X", "WX" (strong
            and weak next), "F", "G", "U", "W" (strong and weak until), "R" or "M" (weak and
            strong release).
        args: operands; & and | have two or more, none of them with the same operator.
        name: name of the proposition, for "ap" only.
    """

    op: str
    args: tuple[Formula, ...] = ()
    name: str = ""
    # The hash, once computed: a list, because the dataclass is frozen.
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
        return parse, (to_text(self),)


TRUE = Formula("true")
FALSE = Formula("false")


def ap(name: str) -> Formula:
    """Return the proposition "`name` is reached in this step".

    Raises:
        ValueError: the name is blank.
    """
    if not name.strip():
        raise ValueError('a name in the formula is empty: write a place or object, such as "chair"')
    return Formula("ap", (), name)


def neg(f: Formula) -> Formula:
    """Return !f."""
    return Formula("!", (f,))


def conj(*fs: Formula) -> Formula:
    """Return f & g & …, nested conjunctions flattened; `true` for none, f itself for one."""
    return _flatten("&", fs, TRUE)


def disj(*fs: Formula) -> Formula:
    """Return f | g | …, nested disjunctions flattened; `false` for none, f itself for one."""
    return _flatten("|", fs, FALSE)


def implies(a: Formula, b: Formula) -> Formula:
    """Return a -> b."""
    return Formula("->", (a, b))


def next_(f: Formula) -> Formula:
    """Return X f: there is a next step, and f holds there."""
    return Formula("X", (f,))


def weak_next(f: Formula) -> Formula:
    """Return WX f: f holds at the next step, if there is one."""
    return Formula("WX", (f,))


def eventually(f: Formula) -> Formula:
    """Return F f: f holds now or at some later step."""
    return Formula("F", (f,))


def always(f: Formula) -> Formula:
    """Return G f: f holds now and at all later steps."""
    return Formula("G", (f,))


def until(a: Formula, b: Formula) -> Formula:
    """Return a U b: b holds at some step, and a at every step before it."""
    return Formula("U", (a, b))


def weak_until(a: Formula, b: Formula) -> Formula:
    """Return a W b: a U b, or a at every step ("not a until b" in English is `!a W b`)."""
    return Formula("W", (a, b))


def postorder(f: Formula) -> Iterator[Formula]:
    """Yield every distinct object of the tree, operands before operators."""
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
    """Return the names in a formula, in order of first appearance."""
    return tuple(dict.fromkeys(node.name for node in postorder(f) if node.op == "ap"))


def renamed(f: Formula, new: Callable[[str], str]) -> Formula:
    """Return the formula with every proposition's name replaced by `new(name)`."""
    done: dict[int, Formula] = {}
    for node in postorder(f):
        if node.op == "ap":
            done[id(node)] = ap(new(node.name))
        else:
            done[id(node)] = Formula(node.op, tuple(done[id(arg)] for arg in node.args))
    return done[id(f)]


def to_text(f: Formula) -> str:
    """Return infix text with minimal parentheses; `parse` returns the same formula from it.

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
    """Return the text of a formula, with its operands as formulas that are still to be written."""
    if f.op == "ap":
        return [_name_text(f.name)]
    if not f.args:
        return [f.op]
    own = STRENGTH[f.op]
    if f.op in UNARY:
        return [f.op if f.op == "!" else f.op + " ", *_operand_text(f.args[0], own)]
    pieces: list[Formula | str] = []
    last = len(f.args) - 1
    for k, arg in enumerate(f.args):
        # Operators except & and | associate to the right: a right operand of the same level
        # needs no parentheses.
        right = k == last and f.op not in "&|"
        pieces += _operand_text(arg, own if right else own + 1)
        if k < last:
            pieces.append(f" {f.op} ")
    return pieces


def _operand_text(f: Formula, at_least: int) -> list[Formula | str]:
    """Return an operand, in parentheses if it binds weaker than `at_least`."""
    return [f] if STRENGTH.get(f.op, _ATOM_STRENGTH) >= at_least else ["(", f, ")"]


def _name_text(name: str) -> str:
    if re.fullmatch(WORD, name) and name not in KEYWORDS and not _separate_operators(name):
        return name
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _flatten(op: str, fs: tuple[Formula, ...], empty: Formula) -> Formula:
    flat: list[Formula] = []
    for f in fs:
        flat.extend(f.args if f.op == op else (f,))
    if len(flat) < 2:
        return flat[0] if flat else empty
    return Formula(op, tuple(flat))


MAX_CHARS = 200_000
"""Longest text that `parse` reads."""
_SPELLINGS = {
    "&&": "&", "∧": "&", "||": "|", "∨": "|", "=>": "->", "→": "->", "<=>": "<->", "↔": "<->",
    "¬": "!", "<>": "F", "◇": "F", "[]": "G", "□": "G", "○": "X",
}  # fmt: skip
_TOKEN = re.compile(
    rf"""(?P<space>\s+)
    | (?P<word>{WORD})
    | (?P<quoted>"(?:[^"\\]|\\.)*")
    | (?P<op><->|<=>|<>|->|=>|\[\]|&&|\|\||[!&|◇□○¬∧∨→↔])
    | (?P<paren>[()])""",
    re.VERBOSE | re.DOTALL,
)
# For words with joined operators such as `Fa` and `aUb`, see `_separate_operators`.
_CAPITALS = re.compile(r"[XFGUWRM]")
_PREFIXED = re.compile(r"(WX|[XFG])([A-Za-z_]\w*)", re.ASCII)
_BINARY = re.compile(r"[UWRM]")
_LETTER = re.compile(r"[A-Za-z][0-9]*")
_NARY = {"&": conj, "|": disj}
_CONSTANTS = {"true": TRUE, "false": FALSE}


class FormulaError(UserError):
    """A text that is no formula.

    Attributes:
        column: column of the first unexpected character, counted from 1; one past the end of the
            text if something is missing there.
    """

    def __init__(self, column: int, message: str) -> None:
        super().__init__(f"formula, column {column}: {message}")
        self.column = column


class _Token(NamedTuple):
    kind: str  # "op", "name", "constant", "(", ")" or "end"
    text: str
    column: int

    @property
    def shown(self) -> str:
        if self.kind == "end":
            return "the end"
        return f"'{one_line(self.text, 40)}'"


def parse(text: str) -> Formula:
    """Return the formula of an infix text.

    Precedence from tightest to loosest: `! X WX F G`; `U W R M`; `&`; `|`; `->`; `<->`. Binary
    operators other than & and | associate to the right. A proposition is a word, or a text in
    double quotes (`\\"` and `\\\\` inside); it must be a name for `edge.names`. `&& || => <=> <>
    []` and ◇ □ ○ ¬ ∧ ∨ → ↔ are accepted too. A word with joined operators, such as `Fa` or `aUb`,
    is refused.

    Raises:
        FormulaError: the text is no formula, a proposition is no name, or the text is longer than
            `MAX_CHARS`.

    Example:
        >>> str(parse("<>(bed && <>sofa)"))
        'F (bed & F sofa)'
    """
    values: list[Formula] = []
    ops: list[_Token] = []
    operand_next = True
    for token in _tokens(text):
        if operand_next:
            operand_next = _take_operand(token, values, ops)
        else:
            operand_next = _take_operator(token, values, ops)
    return values[0]


def _take_operand(token: _Token, values: list[Formula], ops: list[_Token]) -> bool:
    """Process a token where an operand must begin; return True if one must still begin after it."""
    if token.kind == "(" or (token.kind == "op" and token.text in UNARY):
        ops.append(token)
        return True
    if token.kind in ("name", "constant"):
        values.append(_leaf(token))
        return False
    hint = f"expected a proposition, '(' or one of ! X WX F G, found {token.shown}"
    raise FormulaError(token.column, hint)


def _take_operator(token: _Token, values: list[Formula], ops: list[_Token]) -> bool:
    """Process a token after an operand; return True if an operand must begin after it."""
    if token.kind == "op" and token.text not in UNARY:
        while ops and ops[-1].kind == "op" and STRENGTH[ops[-1].text] > STRENGTH[token.text]:
            _reduce(values, ops)
        ops.append(token)
        return True
    if token.kind in (")", "end"):
        while ops and ops[-1].kind == "op":
            _reduce(values, ops)
        if token.kind == ")":
            if not ops:
                raise FormulaError(token.column, "')' closes nothing")
            ops.pop()
        elif ops:
            raise FormulaError(token.column, f"expected ')' for the '(' of column {ops[-1].column}")
        return False
    raise FormulaError(
        token.column, f"expected an operator such as & or U before {token.shown}, or the end"
    )


def _reduce(values: list[Formula], ops: list[_Token]) -> None:
    """Apply the innermost operator; a run of & (or of |) is one operator, applied at once."""
    op = ops.pop().text
    n = 1 if op in UNARY else 2
    while op in _NARY and ops and ops[-1].kind == "op" and ops[-1].text == op:
        ops.pop()
        n += 1
    args = values[-n:]
    del values[-n:]
    values.append(_apply(op, args))


def _apply(op: str, args: list[Formula]) -> Formula:
    return _NARY[op](*args) if op in _NARY else Formula(op, tuple(args))


def _leaf(token: _Token) -> Formula:
    return _CONSTANTS[token.text] if token.kind == "constant" else ap(token.text)


def _tokens(text: str) -> Iterator[_Token]:
    """Yield the tokens of a text, "end" last; raise FormulaError at the first unreadable one."""
    if len(text) > MAX_CHARS:
        raise FormulaError(MAX_CHARS + 1, f"{len(text)} characters; at most {MAX_CHARS} are read")
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            hint = f"{text[at]!r} belongs to no operator; put names in double quotes"
            raise FormulaError(at + 1, "this quote is never closed" if text[at] == '"' else hint)
        kind, found, column = match.lastgroup, match[0], at + 1
        at = match.end()
        if kind == "quoted":
            yield _name_token(re.sub(r"\\(.)", r"\1", found[1:-1], flags=re.DOTALL), column)
        elif kind == "paren":
            yield _Token(found, found, column)
        elif kind != "space":
            op = _SPELLINGS.get(found, found)
            if op in STRENGTH:
                yield _Token("op", op, column)
            elif op in _CONSTANTS:
                yield _Token("constant", op, column)
            else:
                name = _name_token(op, column)
                if spaced := _separate_operators(op):
                    raise FormulaError(column, _missing_spaces_hint(op, spaced))
                yield name
    yield _Token("end", "", len(text) + 1)


def _name_token(text: str, column: int) -> _Token:
    try:
        names.normalise(text)
    except names.NotANameError as error:
        raise FormulaError(column, str(error)) from None
    return _Token("name", text, column)


def _separate_operators(word: str) -> str:
    """Return a word with its operators separated, such as `F a` for `Fa`; "" if it is only a name.

    Names in the alias table, such as `Fridge`, contain no operator.
    """
    if not _CAPITALS.search(word) or word in KEYWORDS or names.is_known(word):
        return ""
    if found := _PREFIXED.fullmatch(word):
        op, operand = found.groups()
        return f"{op} {_separate_operators(operand) or operand}"
    for found in _BINARY.finditer(word, 1):
        left, op, right = word[: found.start()], found[0], word[found.end() :]
        # `livingRoom` is a name; `aRb` and `chairRtable` are not, nor is `pinkBoxUtv`.
        is_until = op == "U" and word[0].islower() and re.match(WORD, right)
        if not is_until and not _is_operand(left):
            continue
        spaced = _separate_operators(right)
        if is_until or spaced or _is_operand(right):
            return f"{left} {op} {spaced or right}"
    return ""


def _is_operand(word: str) -> bool:
    return _LETTER.fullmatch(word) is not None or names.is_known(word)


def _missing_spaces_hint(word: str, spaced: str) -> str:
    word, spaced = one_line(word, 40), one_line(spaced, 60)
    return f"'{word}' lacks spaces: write '{spaced}', or \"{word}\" if it is the name of an object"
