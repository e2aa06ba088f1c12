"""A mission cut into parts: any interleaving of traces that fulfil them fulfils the whole."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ltl_semantics import holds

from edge.mission.language.grammar.instruction import readings
from edge.mission.logic import ltl
from edge.mission.logic.automaton import compile_formula
from edge.mission.split import split


def texts(formula: str) -> list[str]:
    return [str(part) for part in split(ltl.parse(formula)).parts]


@pytest.mark.parametrize(
    ("formula", "parts"),
    [
        ("true", ["true"]),
        ("F bed & F sofa", ["F bed", "F sofa"]),
        ("F bed & F (sofa & F lamp)", ["F bed", "F (sofa & F lamp)"]),
        ("F bed & F sofa & !F sink", ["F bed & !F sink", "F sofa & !F sink"]),
        ("F bed & F sofa & G !(a | b)", ["F bed & G !(a | b)", "F sofa & G !(a | b)"]),
        # A ban about the targets of one part does not bind the other parts.
        ("F (bed | a) & G !a & F tv", ["F (bed | a) & G !a", "F tv & G !a"]),
        # Order binds.
        ("F bed & F sofa & !sofa W bed", ["F bed & F sofa & !sofa W bed"]),
        ("F a & F b & F c & F d & (!b W d)", ["F a", "F b & F d & !b W d", "F c"]),
        ("F bed & !tv W lamp", ["F bed & !tv W lamp"]),
        ("F bed & sofa", ["F bed & sofa"]),
        ("F bed & F (sofa & X lamp)", ["F bed & F (sofa & X lamp)"]),
        ("F bed & F sofa & WX false", ["F bed & F sofa & WX false"]),
    ],
)
def test_parts(formula, parts):
    assert texts(formula) == parts


@pytest.mark.parametrize(
    ("formula", "why"),
    [
        ("F bed & F sofa", ""),
        ("F bed", "it has one part"),
        ("F bed & F sofa & !sofa W bed", "its parts depend on each other"),
        ("F bed & X sofa", "X sofa counts other robots' steps"),
    ],
)
def test_the_reason_why_a_mission_stays_whole(formula, why):
    assert split(ltl.parse(formula)).unsplit_reason == why


def test_the_sentence_of_the_page_has_three_parts():
    text = "go to the bed, the sofa and the lamp in any order; never go to the toilet"
    (formula,) = readings(text)
    assert [str(part) for part in split(formula).parts] == [
        "F bed & G !toilet",
        "F sofa & G !toilet",
        'F "table lamp" & G !toilet',
    ]


PROPOSITIONS = "abcdef"
SMALL = st.recursive(
    st.sampled_from([ltl.ap(x) for x in PROPOSITIONS]),
    lambda f: st.one_of(
        st.builds(ltl.neg, f),
        st.builds(ltl.eventually, f),
        st.builds(ltl.eventually, f),
        st.builds(ltl.always, f),
        st.builds(ltl.next_, f),
        st.builds(ltl.until, f, f),
        st.builds(lambda a, b: ltl.weak_until(ltl.neg(a), b), f, f),
        st.builds(ltl.disj, f, f),
    ),
    max_leaves=3,
)
REACH = st.builds(lambda x: ltl.eventually(ltl.ap(x)), st.sampled_from(PROPOSITIONS))
AVOID = st.builds(lambda x: ltl.always(ltl.neg(ltl.ap(x))), st.sampled_from(PROPOSITIONS))
MISSIONS = st.builds(
    lambda parts: ltl.conj(*parts),
    st.lists(st.one_of(REACH, REACH, AVOID, SMALL), min_size=2, max_size=5),
)


@given(MISSIONS, st.data())
def test_traces_of_the_parts_fulfil_the_whole_in_any_order(formula, data):
    found = split(formula)
    traces = [data.draw(fulfilling(part)) for part in found.parts]
    if any(trace is None for trace in traces):
        return  # a part that nothing fulfils: so is all of it
    trace = []
    while any(traces):
        chosen = data.draw(st.sampled_from([w for w in traces if w]))
        trace.append(chosen.pop(0))
    assert holds(formula, trace)
    assert compile_formula(formula).accepts(trace)


@st.composite
def fulfilling(draw, formula):
    """Return a satisfying trace over a formula's propositions; None if there is none.

    Some random steps, then the path to acceptance.
    """
    automaton = compile_formula(formula)
    state, trace = 0, []
    if automaton.is_dead(0):
        return None
    for _ in range(draw(st.integers(0, 3))):
        hopeful = [(x, to) for x, to in automaton.edges(state) if not automaton.is_dead(to)]
        if not hopeful:
            break
        proposition, state = draw(st.sampled_from(hopeful))
        trace.append(proposition or None)
    seen = {state: []}
    todo = [state]
    for at in todo:  # grows
        if automaton.accepting[at]:
            return trace + seen[at]
        for proposition, to in automaton.edges(at):
            if to not in seen:
                seen[to] = [*seen[at], proposition or None]
                todo.append(to)
    return None


@given(MISSIONS)
def test_no_part_lacks_an_avoidance_and_no_conjunct_is_lost(formula):
    found = split(formula).parts
    conjuncts = formula.args if formula.op == "&" else (formula,)
    kept = {c for part in found for c in (part.args if part.op == "&" else (part,))}
    assert set(conjuncts) <= kept
    assert kept <= set(conjuncts)
