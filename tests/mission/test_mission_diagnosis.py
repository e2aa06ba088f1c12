"""Contradictions, tautologies and propositions that do not matter."""

from __future__ import annotations

import itertools

import pytest

from edge.mission.logic.automaton import CompileError, compile_formula
from edge.mission.logic.diagnosis import conjuncts, diagnose
from edge.mission.logic.ltl import conj, parse


def conflict(text: str) -> list[str]:
    return [str(f) for f in diagnose(compile_formula(parse(text))).contradiction]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("F a", []),
        ("true", []),
        ("F b & F (a & X false)", ["F (a & X false)"]),
        ("F a & F (b & c)", ["F (b & c)"]),
        ("(!a U b) & (!b U c) & (!c U a) & F d", ["!a U b", "!b U c", "!c U a"]),
        ("F a & G !a & F a & G !a", ["F a", "G !a"]),
        ("a & F b & b", ["a", "b"]),
    ],
)
def test_conflict(text, parts):
    assert conflict(text) == parts


@pytest.mark.parametrize(
    "text", ["F a & F b & G !a & G !b & F c", "(!a U b) & (!b U a) & F a & F b & G !c & F c"]
)
def test_conflict_is_minimal(text):
    """Contradictory as a whole, possible without any one part."""
    parts = diagnose(compile_formula(parse(text))).contradiction
    assert not compile_formula(conj(*parts)).accepting.any()
    for rest in itertools.combinations(parts, len(parts) - 1):
        assert compile_formula(conj(*rest)).accepting.any()


@pytest.mark.parametrize(
    ("text", "is_tautology"),
    [
        ("true", True),
        ("F a", False),
        ("F a | G !a", True),
        ("a -> F a", True),
        ("!a W true", True),
        ("F true", False),  # the empty word
    ],
)
def test_tautology(text, is_tautology):
    assert diagnose(compile_formula(parse(text))).tautology == is_tautology


@pytest.mark.parametrize(
    ("text", "unused"),
    [
        ("true", ()),
        ("F a", ()),
        ("F a & (b | !b)", ("b",)),
        ("F (a & (b | true)) | false & c", ("b", "c")),
        ("F a & G (b -> !c)", ("b", "c")),  # two objects at once are impossible anyway
        ("F a & (F b | G !b)", ("b",)),
    ],
)
def test_unused(text, unused):
    assert diagnose(compile_formula(parse(text))).unused == unused


def test_conjuncts_are_flat_and_distinct():
    assert [str(f) for f in conjuncts(parse("a & (b & (c | d) & a)"))] == ["a", "b", "c | d"]


def test_limits_hold():
    text = " & ".join(f"F a{k}" for k in range(12)) + " & G !a0"
    automaton = compile_formula(parse(text))
    assert diagnose(automaton).contradiction == (parse("F a0"), parse("G !a0"))
    with pytest.raises(CompileError, match="states"):
        diagnose(automaton, max_states=100)
    with pytest.raises(CompileError, match="within 0 steps"):
        diagnose(automaton, max_steps=0)
