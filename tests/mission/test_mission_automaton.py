"""The automaton of a formula: right on every trace, minimal, and within its limits."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given
from ltl_semantics import holds
from test_mission_ltl import formulas

from edge.errors import UserError
from edge.mission.logic import automaton as automaton_module
from edge.mission.logic.automaton import CompileError, compile_formula, steps_left
from edge.mission.logic.limits import CompileBudget
from edge.mission.logic.ltl import parse

CASE_1 = (
    "(F (toilet & F bed) | F (couch & F chair) | F (plant & F tv))"
    " & (!tv U bed) & (!toilet U couch) & (!couch U tv)"
)
CASE_2 = (
    "(F (couch & F (toilet & F (bed & F chair))) | F (bed & F (plant | toilet))"
    " | F (tv & F (plant & F couch)))"
    " & (!couch U toilet) & (!bed U tv) & (!plant U chair)"
)
CASE_1_WEAK, CASE_2_WEAK = CASE_1.replace(" U ", " W "), CASE_2.replace(" U ", " W ")
PROPOSITIONS = ("a", "b", "c", None)
TRACES = [trace for n in range(5) for trace in itertools.product(PROPOSITIONS, repeat=n)]


def targets(n: int) -> str:
    return " & ".join(f"F a{k}" for k in range(n))


def same(a, b) -> bool:
    return np.array_equal(a.delta, b.delta) and np.array_equal(a.accepting, b.accepting)


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("true", 1),
        ("false", 1),
        (CASE_2, 30),
        (CASE_1_WEAK, 13),
        ("F (a & F (b & F (c & F (d & F (e & F f)))))", 7),
        (targets(12), 4096),
        ("X X X a", 6),
        ("G F a", 2),
        ("a <-> b <-> c <-> d", 3),
    ],
)
def test_state_counts(text, states):
    """The counts of the published tools, for the formulas as the ViTL paper writes them."""
    assert compile_formula(parse(text)).n_states == states


@given(formulas())
def test_agrees_with_the_definition_on_all_short_words(f):
    automaton = compile_formula(f)
    for trace in TRACES:
        assert automaton.accepts(trace) == holds(f, trace)


@given(formulas())
def test_minimal(f):
    """Myhill–Nerode: a trace distinguishes any two states, every state can be reached."""
    automaton = compile_formula(f)
    n = automaton.n_states
    apart = automaton.accepting[:, None] != automaton.accepting[None, :]
    reached = np.eye(n, dtype=bool)[0]
    for _ in range(n):
        for column in automaton.delta.T:
            apart |= apart[column][:, column]
            reached[column[reached]] = True
    assert (apart | np.eye(n, dtype=bool)).all()
    assert reached.all()


@given(formulas(max_leaves=12))
def test_states_are_numbered_breadth_first(f):
    order = [0]
    automaton = compile_formula(f)
    for state in order:
        order += [t for t in dict.fromkeys(automaton.delta[state].tolist()) if t not in order]
    assert order == list(range(automaton.n_states))


@given(formulas())
def test_steps_left_is_the_fewest_objects(f):
    """Against a search over traces with up to four objects and idle steps between them."""
    automaton = compile_formula(f)
    left = automaton.steps_left
    for state in range(automaton.n_states):
        here, objects = idle(automaton, {state}), 0
        while objects < 5 and not automaton.accepting[list(here)].any():
            here = idle(automaton, {int(t) for s in here for t in automaton.delta[s, :-1]})
            objects += 1
        assert left[state] == objects or (objects == 5 and not 0 <= left[state] < 5)


def idle(automaton, states: set[int]) -> set[int]:
    """States that can be reached with no object at all."""
    while True:
        wider = states | {int(automaton.delta[s, -1]) for s in states}
        if wider == states:
            return states
        states = wider


def test_limit_of_states():
    assert compile_formula(parse(targets(6)), max_states=64).n_states == 64
    with pytest.raises(CompileError, match="more than 63 states; use fewer targets"):
        compile_formula(parse(targets(6)), max_states=63)
    with pytest.raises(CompileError, match="more than 20000 states"):
        compile_formula(parse(targets(40)))
    assert issubclass(CompileError, UserError)


@pytest.mark.parametrize(
    "text",
    [
        targets(12),
        "F a0" + "".join(f" <-> F a{k}" for k in range(1, 40)),
        "F (" + " & ".join(f"(F a{k} | F b{k})" for k in range(15)) + ")",
        "X " * 9_000 + "a",
        " & ".join(f"F (a{k} & X X X X X b{k})" for k in range(20)),
    ],
    ids=["targets", "equivalences", "wide inside", "deep next", "memory"],
)
def test_limit_of_steps(text):
    """Counted on every way through the compiler: none of these could end by itself so soon."""
    formula = parse(text)
    with pytest.raises(CompileError, match=r"not compiled within 20000 steps; use fewer targets"):
        compile_formula(formula, max_steps=20_000)
    with pytest.raises(CompileError, match="within 0 steps"):
        steps_left(np.zeros((1, 1), np.int32), np.ones(1, bool), CompileBudget(1, 0))


@pytest.mark.parametrize(
    "text", ["F a", CASE_2, targets(8), "(F a | F b) & (F c | F d) & (G !e | F b)", "X " * 40 + "a"]
)
def test_steps_are_counted_the_same_every_time(text, monkeypatch):
    """Exactly so many steps are enough, however late it gets meanwhile."""
    needed = steps_of(text, monkeypatch)
    late = itertools.count(0.0, 1e6)
    for clock in ("time", "monotonic", "perf_counter", "process_time", "thread_time"):
        monkeypatch.setattr(time, clock, lambda: next(late))
        monkeypatch.setattr(time, f"{clock}_ns", lambda: int(next(late) * 1e9))
    assert steps_of(text, monkeypatch) == needed
    automaton = compile_formula(parse(text), max_steps=needed)
    assert same(automaton, compile_formula(parse(text)))
    with pytest.raises(CompileError, match=f"within {needed - 1} steps"):
        compile_formula(parse(text), max_steps=needed - 1)


def steps_of(text, monkeypatch) -> int:
    made = []

    class Noted(CompileBudget):
        def __init__(self, *args):
            super().__init__(*args)
            made.append(self)

    with monkeypatch.context() as patch:
        patch.setattr(automaton_module, "CompileBudget", Noted)
        compile_formula(parse(text))
    return made[-1].steps


def test_automata_do_not_depend_on_the_hash_seed():
    formulas = ["F a", CASE_2_WEAK, targets(8), "(F a | F b) <-> (F c U (d | G e))"]
    program = (
        "import sys; from edge.mission.logic.automaton import compile_formula\n"
        "from edge.mission.logic import limits\n"
        "from edge.mission.logic.ltl import parse\n"
        "def counted(self, n): limits.total = getattr(limits, 'total', 0) + n\n"
        "limits.CompileBudget.spend = counted\n"
        "for text in sys.argv[1:]:\n"
        "    a = compile_formula(parse(text))\n"
        "    print(a.propositions, a.delta.tolist(), a.accepting.tolist(), limits.total)"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program, *formulas], env={**os.environ, "PYTHONHASHSEED": seed},
            check=True, capture_output=True, text=True,
        ).stdout
        for seed in ("0", "1", "2")
    }  # fmt: skip
    assert len(outputs) == 1
    assert outputs.pop().count("\n") == len(formulas)


def test_limit_of_size():
    """Steps alone would let wide states fill the memory."""
    with pytest.raises(CompileError, match="more than 10000 different subformulas"):
        compile_formula(parse("X " * 11_000 + "a"))


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("!" * 1000 + "a", 3),
        ("X " * 300 + "a", 303),
        ("F (a & " * 300 + "b" + ")" * 300, 1),
        ("G (a | " * 300 + "b" + ")" * 300, 2),
        (" & ".join(f"(F a{k} | F b{k})" for k in range(8)), 256),
        (" & ".join(f"G F a{k}" for k in range(40)), 2),
        (" & ".join(f"(!a{k + 1} W a{k})" for k in range(39)), 41),
        ("a0" + "".join(f" <-> a{k}" for k in range(1, 40)), 3),
    ],
    ids=lambda value: str(value)[:20],
)
def test_large_formulas_compile(text, states):
    assert compile_formula(parse(text)).n_states == states
