"""The benchmark's tasks: each sentence means its formula."""

from __future__ import annotations

import hashlib
from collections import Counter

import pytest

from edge import names
from edge.lab.eval.planning.delexicalised import HM3D_OBJECTS, delexicalise
from edge.lab.eval.planning.templates import (
    FAMILIES,
    JOINTS,
    Template,
    formula_of,
    generate,
    sentence_of,
)
from edge.mission.logic.ltl import parse, propositions, to_text

DIGEST = "21de6270f80f429f"
OBJECTS = ("bed", "television", "sofa", "toilet", "chair", "houseplant")


@pytest.fixture(scope="module")
def tasks():
    return generate(400)


@pytest.mark.parametrize(
    ("template", "sentence", "formula"),
    [
        (Template((((0,),),)), "Reach a bed.", "F bed"),
        (
            Template((((0,), (1,), (2,)), ((3,), (4,)))),
            "Reach a bed, then a tv, then a couch; or reach a toilet, then a chair.",
            "F(bed & F(television & F sofa)) | F(toilet & F chair)",  # the paper's example
        ),
        (
            Template((((4, 2), (1,)),), joint=JOINTS[2]),
            "Reach either a chair or a couch, then reach a tv.",
            "F((chair | sofa) & F television)",  # the paper's running example
        ),
        (
            Template((((4, 2), (1,)),), joint=JOINTS[1]),
            "Reach either a chair or a couch, then a tv.",  # " and then" could be misread
            "F((chair | sofa) & F television)",
        ),
        (
            Template((((0,), (5, 3)),), joint=JOINTS[1]),
            "Reach a bed and then either a potted plant or a toilet.",
            "F(bed & F(houseplant | toilet))",
        ),
        (
            Template((((0,), (1,), (2,)),), any_order=True),
            "Reach a bed, a tv and a couch in any order.",
            "F bed & F television & F sofa",
        ),
        (
            Template((((1,),),), untils=((1, 0), (3, 2)), avoided=(4,)),
            "Reach a tv. Do not reach a tv until a bed is reached, and do not reach a toilet "
            "until a couch is reached. Never reach a chair.",
            "F television & (!television W bed) & (!toilet W sofa) & G !chair",
        ),
    ],
)
def test_sentence_and_formula(template, sentence, formula):
    assert sentence_of(template, OBJECTS) == sentence
    assert formula_of(template, OBJECTS) == parse(formula)


def test_the_benchmark_is_the_same_for_everybody(tasks):
    """Figures of different machines and versions can be compared only as long as this holds."""
    text = "\n".join(f"{task.sentence} {to_text(task.formula)}" for task in tasks)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == DIGEST


def test_tasks_are_distinct_can_be_fulfilled_and_name_their_objects(tasks):
    assert [task.id for task in tasks] == list(range(400))
    assert len({task.formula for task in tasks}) == len({task.sentence for task in tasks}) == 400
    for task in tasks:
        assert delexicalise(task.formula).automaton.steps_left[0] > 0
        assert set(propositions(task.formula)) <= set(HM3D_OBJECTS)
        assert parse(to_text(task.formula)) == task.formula


def test_every_object_of_a_sentence_is_in_its_formula(tasks):
    for task in tasks:
        words = task.sentence.lower().replace("potted plant", "plant")
        spoken = {
            names.canonical(after.split()[0].strip(",;."))
            for after in words.split(" a ")[1:]
        }  # fmt: skip
        assert spoken == set(propositions(task.formula)), task.sentence


def test_families_are_drawn_by_their_shares(tasks):
    counts = Counter(task.family for task in tasks)
    assert set(counts) == {family.name for family in FAMILIES}
    assert counts["single"] <= 6  # there are no more different ones
    assert counts.most_common(1)[0][0] == "branches-until"
    assert {len(propositions(task.formula)) for task in tasks} == {1, 2, 3, 4, 5, 6}
