"""Benchmark: compilation of a formula to its automaton, and parsing of its text."""

from __future__ import annotations

import pytest

from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse

# Formula and number of states. f2 and f3 are the case studies of the ViTL paper.
FORMULAS = {
    "f1": ("F((chair | couch) & F tv)", 3),
    "f2": (
        "(F(toilet & F bed) | F(couch & F chair) | F(plant & F tv))"
        " & (!tv U bed) & (!toilet U couch) & (!couch U tv)",
        13,
    ),
    "f3": (
        "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet))"
        " | F(tv & F(plant & F couch))) & (!couch U toilet) & (!bed U tv) & (!plant U chair)",
        30,
    ),
    "f4": ("F a & F b & F c & F d & F e & F f", 64),
    "f5": ("F(a & F(b & F(c & F(d & F(e & F f)))))", 7),
    "12_targets": (" & ".join(f"F a{k}" for k in range(12)), 4096),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_compile(benchmark, name):
    benchmark.extra_info["budget"] = f"ltl_compile_{name}"
    text, states = FORMULAS[name]
    formula = parse(text)
    rounds = 5 if states > 1000 else 300
    automaton = benchmark.pedantic(
        compile_formula, args=(formula,), rounds=rounds, warmup_rounds=rounds // 5
    )
    assert automaton.n_states == states


def test_parse_f3(benchmark):
    benchmark.extra_info["budget"] = "ltl_parse_f3"
    assert benchmark(parse, FORMULAS["f3"][0]).op == "&"
