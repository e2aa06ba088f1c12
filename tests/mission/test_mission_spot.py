"""Spot as the compiler: only the real one, and with the same automata."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from test_mission_automaton import CASE_1, CASE_2, CASE_2_WEAK, same, targets
from test_mission_ltl import formulas

from edge.errors import UserError
from edge.mission.logic import spot_compiler
from edge.mission.logic.automaton import CompileError, compile_formula
from edge.mission.logic.ltl import parse, propositions

needs_spot = pytest.mark.skipif(
    not spot_compiler.available(), reason=f"Spot: {spot_compiler.missing()}"
)


def module(name: str, **attributes: object) -> ModuleType:
    made = ModuleType(name)
    made.__dict__.update(attributes)
    return made


@pytest.mark.parametrize(
    ("modules", "says"),
    [
        ({"spot": None}, "no module 'spot' is installed"),
        ({"spot": module("spot", Environment=object)}, "'spot' is not Spot's: it has no 'formula'"),
        (
            {"spot": module("spot", formula=str, from_ltlf=str, translate=str)},
            "it has no 'to_finite'",
        ),
        (
            {
                "spot": module("spot", formula=str, from_ltlf=str, translate=str, to_finite=str),
                "buddy": module("buddy"),
            },
            "'buddy' is not Spot's",
        ),
    ],
    ids=["none", "the other package", "too old", "other buddy"],
)
def test_wrong_spot_modules_are_recognised(monkeypatch, modules, says):
    for name, fake in modules.items():
        monkeypatch.setitem(sys.modules, name, fake)
    assert not spot_compiler.available()
    with pytest.raises(UserError, match=r"compiler 'spot': .*; install .*, or choose") as error:
        compile_formula(parse("F a"), compiler="spot")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_own_needs_no_spot(monkeypatch):
    monkeypatch.setitem(sys.modules, "spot", None)
    assert same(
        compile_formula(parse("F a & F b"), compiler="own"), compile_formula(parse("F a & F b"))
    )


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("true", "true"),
        ("X a", "X[!] (p0)"),
        ("WX !a", "X (!(p0))"),
        ("F (bed & !\"potted plant\") U bed", "(F((p0) & (!(p1)))) U (p0)"),
        ("alive -> a -> alive", "(p0) -> ((p1) -> (p0))"),
    ],
)  # fmt: skip
def test_text_for_spot(text, written):
    f = parse(text)
    assert spot_compiler._text(f, propositions(f)) == written


@needs_spot
@pytest.mark.parametrize(
    "text",
    ["true", "false", "F a", "!a", "X a", "WX a", "G false", "F true", CASE_1, CASE_2, CASE_2_WEAK,
     targets(6), "alive & F p0", "WX (!a & WX b) <-> a M !b"],
)  # fmt: skip
def test_same_automaton(text):
    assert same(compile_formula(parse(text), compiler="spot"), compile_formula(parse(text)))


@needs_spot
@given(formulas(max_leaves=6))
def test_same_automaton_of_any_formula(f):
    ours, spots = compile_formula(f), compile_formula(f, compiler="spot")
    assert same(ours, spots)
    assert np.array_equal(ours.steps_left, spots.steps_left)


@needs_spot
def test_limits():
    with pytest.raises(CompileError, match="states"):
        compile_formula(parse(targets(6)), max_states=30, compiler="spot")
    with pytest.raises(CompileError, match="within 0 steps"):
        compile_formula(parse("F a"), max_steps=0, compiler="spot")
    with pytest.raises(CompileError, match="nested deeper than 1000"):
        compile_formula(parse("!" * 1001 + "a"), compiler="spot")
