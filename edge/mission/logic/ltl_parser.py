"""Text to formula, infix and prefix, by operator precedence with explicit stacks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from edge import names
from edge.errors import UserError
from edge.mission.logic.formula import FALSE, STRENGTH, TRUE, UNARY, WORD, Formula, ap, conj, disj
from edge.text import one_line

MAX_CHARS = 200_000
_SPELLINGS = {
    "&&": "&", "∧": "&", "||": "|", "∨": "|", "=>": "->", "→": "->", "<=>": "<->", "↔": "<->",
    "¬": "!", "<>": "F", "◇": "F", "[]": "G", "□": "G", "○": "X",
}  # fmt: skip
_PREFIX_SPELLINGS = _SPELLINGS | {"i": "->", "e": "<->"}
_TOKEN = re.compile(
    rf"""(?P<space>\s+)
    | (?P<word>{WORD})
    | (?P<quoted>"(?:[^"\\]|\\.)*")
    | (?P<op><->|<=>|<>|->|=>|\[\]|&&|\|\||[!&|◇□○¬∧∨→↔])
    | (?P<paren>[()])""",
    re.VERBOSE | re.DOTALL,
)
_NARY = {"&": conj, "|": disj}
_CONSTANTS = {"true": TRUE, "false": FALSE}


class FormulaError(UserError):
    """A text that is no formula.

    Attributes:
        column: of the first character that does not fit, counted from 1; one past the end of
            the text when something is missing there.
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
    """The formula that an infix text writes.

    From tightest to loosest: `! X WX F G`; `U W R M`; `&`; `|`; `->`; `<->`; binary operators
    other than & and | associate to the right. Propositions are words, or anything in double
    quotes (`\\"` and `\\\\` inside), that `edge.names` takes for a name. `&& || => <=> <> []` and
    ◇ □ ○ ¬ ∧ ∨ → ↔ are read too.

    Raises:
        FormulaError: the text is no formula, a proposition is no name, or the text is longer than
            `MAX_CHARS`.
    """
    values: list[Formula] = []
    ops: list[_Token] = []
    operand_next = True
    for token in _tokens(text, _SPELLINGS):
        if operand_next:
            operand_next = _operand(token, values, ops)
        else:
            operand_next = _operator(token, values, ops)
    return values[0]


def parse_prefix(text: str) -> Formula:
    """The formula that a prefix text writes, as Lang2LTL's data does: `& F a U ! b c`.

    `i` is implication and `e` equivalence; every other word that is no operator of `parse` is a
    proposition.

    Raises:
        FormulaError: the text is no formula, or longer than `MAX_CHARS`.
    """
    waiting: list[_Waiting] = []
    done: Formula | None = None
    for token in _tokens(text, _PREFIX_SPELLINGS):
        if done is not None:
            if token.kind == "end":
                return done
            raise FormulaError(token.column, f"the formula is complete before {token.shown}")
        if token.kind == "op":
            if token.text in _NARY and waiting and waiting[-1].op == token.text:
                waiting[-1].missing += 1
            else:
                waiting.append(_Waiting(token.text, 1 if token.text in UNARY else 2))
        elif token.kind in ("name", "constant"):
            done = _close(waiting, _leaf(token))
        else:
            raise FormulaError(token.column, _wants_operand(token))
    raise AssertionError("the end token is always handled")


@dataclass(slots=True)
class _Waiting:
    """A prefix operator and how many operands it still lacks."""

    op: str
    missing: int
    args: list[Formula] = field(default_factory=list)


def _close(waiting: list[_Waiting], value: Formula) -> Formula | None:
    """Hand a value to the innermost operator that waits; the whole formula once none does."""
    while waiting:
        inner = waiting[-1]
        inner.args.append(value)
        inner.missing -= 1
        if inner.missing:
            return None
        waiting.pop()
        value = _apply(inner.op, inner.args)
    return value


def _operand(token: _Token, values: list[Formula], ops: list[_Token]) -> bool:
    """Take a token where an operand must begin; whether one must still begin after it."""
    if token.kind == "(" or (token.kind == "op" and token.text in UNARY):
        ops.append(token)
        return True
    if token.kind in ("name", "constant"):
        values.append(_leaf(token))
        return False
    raise FormulaError(token.column, _wants_operand(token))


def _operator(token: _Token, values: list[Formula], ops: list[_Token]) -> bool:
    """Take a token after an operand; whether an operand must begin after it."""
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
    """Apply the innermost operator; a run of & (or of |) at once, since it is one operator."""
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


def _wants_operand(token: _Token) -> str:
    return f"expected a proposition, '(' or one of ! X WX F G, found {token.shown}"


def _tokens(text: str, spellings: dict[str, str]) -> Iterator[_Token]:
    if len(text) > MAX_CHARS:
        raise FormulaError(MAX_CHARS + 1, f"{len(text)} characters; at most {MAX_CHARS} are read")
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise FormulaError(at + 1, _unreadable(text[at]))
        kind, found, column = match.lastgroup, match[0], at + 1
        at = match.end()
        if kind == "quoted":
            yield _name(re.sub(r"\\(.)", r"\1", found[1:-1], flags=re.DOTALL), column)
        elif kind == "paren":
            yield _Token(found, found, column)
        elif kind != "space":
            op = spellings.get(found, found)
            if op in STRENGTH:
                yield _Token("op", op, column)
            elif op in _CONSTANTS:
                yield _Token("constant", op, column)
            else:
                yield _name(op, column)
    yield _Token("end", "", len(text) + 1)


def _name(text: str, column: int) -> _Token:
    try:
        names.normalise(text)
    except names.NotANameError as error:
        raise FormulaError(column, str(error)) from None
    return _Token("name", text, column)


def _unreadable(char: str) -> str:
    if char == '"':
        return "this quote is never closed"
    return f"{char!r} belongs to no operator; put names in double quotes"
