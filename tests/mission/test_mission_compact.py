"""Formulas as the small translator writes them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.prefix_notation import MOST_NAMES, REFUSED, allowed, formula_of
from edge.mission.logic.ltl import parse, propositions

MEANT = [
    ("<0>", "a"),
    ("F <0>", "F a"),
    ("F & <1> F <0>", "F (b & F a)"),
    ("& F <0> G ! <1>", "F a & G !b"),
    ("F & | <0> <1> F <2>", "F ((a | b) & F c)"),
    ("W ! <1> <0>", "!b W a"),
    ("G -> <0> X <1>", "G (a -> X b)"),
    ("G <-> <0> X <1>", "G (a <-> X b)"),
    (">=2 <0>", "F (a & F (!a & F a))"),
    ("<=1 <0>", "!F (a & F (!a & F a))"),
    ("=1 <0>", "F a & !F (a & F (!a & F a))"),
    (">=2 | <0> <1>", "F ((a | b) & F (!(a | b) & F (a | b)))"),
    ("O <0> <1>", "!a W (a W (!a W b))"),
]


@pytest.mark.parametrize(("tokens", "text"), MEANT)
def test_meanings(tokens: str, text: str) -> None:
    assert distinguishing_trace(formula_of(tokens.split(), "abc"), parse(text)) is None


@pytest.mark.parametrize("tokens", ["", "F", "<3>", "F <0> <1>", "& <0>", REFUSED, "F sofa"])
def test_invalid_prefix_tokens_raise(tokens: str) -> None:
    with pytest.raises(ValueError, match="is not a formula in prefix notation over 3 names"):
        formula_of(tokens.split(), "abc")


@given(st.data(), st.integers(1, MOST_NAMES), st.integers(1, 24))
def test_any_allowed_token_sequence_ends_in_a_formula(
    data: st.DataObject, names: int, most: int
) -> None:
    written: list[str] = []
    while options := [t for t in allowed(written, names, most) if t != REFUSED]:
        written.append(data.draw(st.sampled_from(options)))
    assert len(written) <= most
    formula = formula_of(written, [f"x{i}" for i in range(names)])
    assert 1 <= len(propositions(formula)) <= names


def test_only_the_first_token_refuses() -> None:
    assert REFUSED in allowed((), 1, 9)
    assert REFUSED not in allowed(("F",), 1, 9)
    assert not list(allowed(("F", "<0>"), 1, 9))
