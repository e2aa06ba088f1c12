"""Formulas: parsing, text and meaning."""

from __future__ import annotations

import copy
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ltl_semantics import holds

from edge.mission.logic import ltl
from edge.mission.logic.ltl import MAX_CHARS, FormulaError, parse, propositions, to_text

A, B, C, D = (ltl.ap(name) for name in "abcd")


def binary(op: str):
    """Return the formula of two operands."""
    return lambda a, b: ltl.Formula(op, (a, b))


def formulas(names: tuple[str, ...] = ("a", "b", "c"), max_leaves: int = 8):
    """Any formula over some propositions."""
    leaves = st.sampled_from([*map(ltl.ap, names), ltl.TRUE, ltl.FALSE])
    unary = st.sampled_from([ltl.neg, ltl.next_, ltl.weak_next, ltl.eventually, ltl.always])
    joined = st.sampled_from(list(map(binary, ("->", "<->", "U", "W", "R", "M"))))
    nary = st.sampled_from([ltl.conj, ltl.disj])

    def grow(inner):
        return st.one_of(
            st.builds(lambda op, f: op(f), unary, inner),
            st.builds(lambda op, f, g: op(f, g), joined, inner, inner),
            st.builds(lambda op, fs: op(*fs), nary, st.lists(inner, min_size=2, max_size=3)),
        )

    return st.recursive(leaves, grow, max_leaves=max_leaves)


@pytest.mark.parametrize(
    ("text", "formula"),
    [
        ("a", A),
        ("true", ltl.TRUE),
        ("True", ltl.ap("True")),
        ('"F"', ltl.ap("F")),
        (r'"a \"b\" \\c"', ltl.ap('a "b" \\c')),
        ("!a", ltl.neg(A)),
        ("F G a", ltl.eventually(ltl.always(A))),
        ("F a U b", ltl.until(ltl.eventually(A), B)),
        ("a U b U c", ltl.until(A, ltl.until(B, C))),
        ("(a U b) U c", ltl.until(ltl.until(A, B), C)),
        ("a & b | c & d", ltl.disj(ltl.conj(A, B), ltl.conj(C, D))),
        ("a & (b & c) & d", ltl.conj(A, B, C, D)),
        ("a -> b -> c", ltl.implies(A, ltl.implies(B, C))),
        ("a <-> b <-> c", binary("<->")(A, binary("<->")(B, C))),
        ("a => b", ltl.implies(A, B)),
        ("<> a | [] b", ltl.disj(ltl.eventually(A), ltl.always(B))),
        ("a → b ↔ c", parse("a -> b <-> c")),
        ("F(a) & G!b", ltl.conj(ltl.eventually(A), ltl.always(ltl.neg(B)))),
        ("F livingRoom | X1", ltl.disj(ltl.eventually(ltl.ap("livingRoom")), ltl.ap("X1"))),
        ("\n a\t&\r\n b", ltl.conj(A, B)),
    ],
)
def test_parse(text, formula):
    assert parse(text) == formula


@pytest.mark.parametrize(
    ("text", "column", "says"),
    [
        ("", 1, "found the end"),
        ("   ", 4, "found the end"),
        ("a b", 3, "expected an operator such as & or U before 'b'"),
        ("F (a & (b | c)", 15, "'(' of column 3"),
        ("a)", 2, "')' closes nothing"),
        ("()", 2, "found ')'"),
        ("F", 2, "found the end"),
        ("a # b", 3, "'#' belongs to no operator"),
        ('a & "bed', 5, "this quote is never closed"),
        ('a & " "', 5, "'' is no name"),
        ("F _", 3, "'_' is no name: it needs a letter or a digit"),
        ('F "\x1b[2Jtv"', 3, "character 1 (U+001B) does not print"),
        ('F "t\nv"', 3, "character 2 (U+000A) does not print"),
        ("F " + "b" * 201, 3, "more than 200 characters"),
        ("a & \0", 5, r"'\x00'"),
        ("!b & Ga", 6, "write 'G a'"),
        ("FGa", 1, "write 'F G a'"),
        ("FChair", 1, "write 'F Chair'"),
        ("aUb", 1, "write 'a U b'"),
        ("pinkBoxUp2", 1, "write 'pinkBox U p2'"),
        ("diningRoomUb", 1, "write 'diningRoom U b'"),
        ("chairWtable", 1, "write 'chair W table'"),
    ],
)
def test_parse_error(text, column, says):
    with pytest.raises(FormulaError) as error:
        parse(text)
    assert error.value.column == column
    assert str(error.value).startswith(f"formula, column {column}: ")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@given(formulas(("a", "potted plant", "F", "Fa", "aUb", 'x"\\', "true")))
def test_text_is_read_back(f):
    assert parse(to_text(f)) == f


def column_of_error(read, text: str) -> int | None:
    try:
        read(text)
    except FormulaError as error:
        return error.column
    return None


@given(
    st.lists(st.sampled_from([*'ab"()!&|→U', "F ", " W ", "->", "<", "\\", "true"])).map("".join)
)
def test_near_formulas_give_a_formula_or_a_column(text):
    column = column_of_error(parse, text)
    if column is None:
        assert parse(to_text(parse(text))) == parse(text)
    else:
        assert 1 <= column <= len(text) + 1


DEEP = 2_000


@pytest.mark.parametrize(
    "text",
    [
        "(" * DEEP + "a" + ")" * DEEP,
        "!" * DEEP + "a",
        "F " * DEEP + "a",
        "a U " * DEEP + "a",
        "a -> " * DEEP + "a",
        "a & " * DEEP + "a",
        "(a & " * DEEP + "a" + ")" * DEEP,
        "(a | (a & " * 1000 + "a" + "))" * 1000,
    ],
    ids=["parentheses", "not", "F", "U", "->", "&", "& in parentheses", "& | in turns"],
)
def test_deep_formulas_are_supported(text):
    f = parse(text)
    assert parse(to_text(f)) == f
    assert hash(parse(text)) == hash(f)
    assert propositions(ltl.renamed(f, str.upper)) == ("A",)
    assert holds(f, ["a"]) in (True, False)
    assert pickle.loads(pickle.dumps(f)) == copy.deepcopy(f) == f


def test_unclosed_parentheses_and_long_texts_are_refused():
    with pytest.raises(FormulaError, match=r"column 50002: expected '[)]' for the '[(]' of column"):
        parse("(" * 50_000 + "a")
    with pytest.raises(FormulaError, match="at most"):
        parse("a" * (MAX_CHARS + 1))


def test_equality_is_of_trees():
    assert ltl.until(A, B) == ltl.until(ltl.ap("a"), ltl.ap("b"))
    assert ltl.until(A, B) != ltl.until(B, A)
    assert ltl.until(A, B) != ltl.weak_until(A, B)
    assert ltl.conj(A, B) != ltl.conj(A, B, A)
    assert A != "a"
    assert len({A, ltl.ap("a"), B}) == 2


def test_constructors():
    assert ltl.conj() == ltl.TRUE
    assert ltl.disj() == ltl.FALSE
    assert ltl.conj(A) == A
    assert ltl.conj(A, ltl.conj(B, C)) == ltl.conj(A, B, C)
    assert ltl.disj(ltl.disj(A, B), ltl.conj(C, D)).args == (A, B, ltl.conj(C, D))
    with pytest.raises(ValueError, match="name"):
        ltl.ap(" ")
