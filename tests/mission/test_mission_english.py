"""Formulas in English, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.eval.equivalence import distinguishing_trace
from edge.lab.eval.planning.templates import generate
from edge.mission.language.grammar.english import describe
from edge.mission.language.grammar.instruction import readings
from edge.mission.logic import ltl
from edge.mission.logic.ltl import Formula, ap, parse

SAID = [
    ("true", "Nothing needs to be done."),
    ("false", "This cannot be done."),
    ("F bed", "Reach the bed."),
    ("F a", "Reach a."),
    ("F bed & F chair & F a", "Reach the bed, the chair and a in any order."),
    ("F((chair | sofa) & F television) & (!bed W television)",
     "Reach either the chair or the sofa, then the television. "
     "Do not reach the bed until the television is reached."),
    ("F(bed & F(television & F sofa)) | F toilet",
     "Reach the bed, then the television, then the sofa; or reach the toilet."),
    ("(F bed & (!sofa W bed)) | F toilet",
     "Reach the bed, but do not reach the sofa until the bed is reached; or reach the toilet."),
    ("F(bed & F sofa & F desk)", "Reach the bed, then the sofa and the desk in any order."),
    ("F(bed & X F bed)", "Reach the bed, then the bed again."),
    ("F(bed & F(!bed & F(bed & F sofa)))", "Reach the bed at least twice, then the sofa."),
    ("F bed & !F(bed & F(!bed & F bed))", "Reach the bed exactly once."),
    ("!F(bed & F(!bed & F bed))", "Reach the bed at most once."),
    ("!bed W (bed W (!bed W sofa))", "Reach the bed at most once until the sofa is reached."),
    ("!bed U sofa",
     "Do not reach the bed until the sofa is reached, and the sofa must be reached."),
    ("G !bed & G !(sofa | desk)", "Never reach the bed. Never reach the sofa or the desk."),
    ("G(bed -> F sofa)", "Whenever the bed is reached, the sofa must be reached later."),
    ("G(bed -> X sofa)", "Whenever the bed is reached, the sofa must be reached at the next step."),
    ("G(bed -> G !sofa)", "Once the bed is reached, never reach the sofa."),
    ('F end & F "avoid bed"', 'Reach "end" and "avoid bed" in any order.'),
    ("bed",
     "See to it, from the first step on, that the bed is reached at that step."),
    ("F(bed & F bed)",  # the same visit may count twice, so it must not read "then the bed"
     "See to it, from the first step on, that now or later (the bed is reached at that step and "
     "(now or later the bed is reached at that step))."),
    ('F "shelf 12" & G !"gate b"', "Reach shelf 12. Never reach gate b."),
]  # fmt: skip


@pytest.mark.parametrize(("formula", "english"), SAID)
def test_english_of_a_formula(formula: str, english: str) -> None:
    assert describe(parse(formula)) == english


@pytest.mark.parametrize("formula", [formula for formula, said in SAID if "See to" not in said][2:])
def test_the_english_means_the_formula(formula: str) -> None:
    """The grammar reads the sentence back as the same language."""
    f = parse(formula)
    (again,) = readings(describe(f))
    assert distinguishing_trace(again, f) is None


def test_the_english_of_every_kind_of_benchmark_task_is_faithful() -> None:
    """Sentence → formula → sentence → formula: the language never changes."""
    for task in generate(200, seed=3):
        (again,) = readings(describe(task.formula))
        assert distinguishing_trace(again, task.formula) is None, describe(task.formula)


NAMES = st.sampled_from(["bed", "sofa", "trash can", "the end", "a", 'odd"name', "until", "go on"])
OPERATORS = st.sampled_from(["!", "X", "WX", "F", "G", "U", "W", "R", "M", "&", "|", "->", "<->"])


def _formulas(children: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    def apply(op: str, a: Formula, b: Formula) -> Formula:
        if op in ("!", "X", "WX", "F", "G"):
            return Formula(op, (a,))
        return {"&": ltl.conj, "|": ltl.disj}.get(op, lambda x, y: Formula(op, (x, y)))(a, b)

    return st.builds(apply, OPERATORS, children, children)


@given(st.recursive(NAMES.map(ap), _formulas, max_leaves=8))
def test_any_formula_has_english_that_is_never_wrong(formula: Formula) -> None:
    """A formula that is not read literally has the same language when read back.

    "Do not reach the bed until the sofa is reached" has more readings, the literal one first.
    """
    english = describe(formula)
    assert english.endswith(".")
    if "See to it" not in english and '"' not in english:
        again = readings(english)[0]
        assert distinguishing_trace(again, formula) is None, english


def test_deep_and_long_formulas_are_shown_as_they_are() -> None:
    deep = ap("bed")
    for _ in range(5000):
        deep = ltl.neg(deep)
    wide = ltl.conj(*(ltl.eventually(ap(f"x{i}")) for i in range(1000)))
    for formula in (deep, wide):
        assert describe(formula).startswith("Fulfil this formula")
        assert len(describe(formula)) < 3000
