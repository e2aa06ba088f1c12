"""Our compiler against Spot: the same automata."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from spot_twin import compile_by_spot, missing
from test_mission_automaton import CASE_1, CASE_2, CASE_2_WEAK, same, targets
from test_mission_ltl import formulas

from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse

pytestmark = pytest.mark.skipif(missing() != "", reason=f"Spot: {missing()}")


@pytest.mark.parametrize(
    "text",
    ["true", "false", "F a", "!a", "X a", "WX a", "G false", "F true", CASE_1, CASE_2, CASE_2_WEAK,
     targets(6), "alive & F p0", "WX (!a & WX b) <-> a M !b"],
)  # fmt: skip
def test_same_automaton(text):
    assert same(compile_by_spot(parse(text)), compile_formula(parse(text)))


@given(formulas(max_leaves=6))
def test_same_automaton_of_any_formula(f):
    ours, spots = compile_formula(f), compile_by_spot(f)
    assert same(ours, spots)
    assert np.array_equal(ours.steps_left, spots.steps_left)
