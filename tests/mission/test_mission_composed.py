"""Sentences composed from formulas, which the grammar must not read as another one."""

from __future__ import annotations

from random import Random

from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.instruction import TranslationError, readings
from edge.mission.language.grammar.prefix_notation import NAMES, REFUSED, formula_of
from edge.mission.logic.ltl import to_text
from edge.mission.readings import distinct
from exporters.training.translator.compose import Composer, load

OBJECTS = ("sofa", "bed", "oven", "chair", "desk", "floor lamp", "door", "window")
DRAWN = 1000
DEBATABLE = {
    "F & x F": "whether 'visit a and open b', or 'a by way of b or c', is in order",
    "F & | x x F": "as before",
    "& F x W ! x x": "whether 'a before b' asks for b",
    "G -> x F": "whether 'once you reach a, go to b' asks for a",
    "G -> x X": "whether 'as soon as you reach a' is a duty",
    "O x x": "how far 'and only then' reaches",
    "W ! x x W ! x x": "whether 'not c before b, nor b before a' asks for c",
    "G ! x <=": "how far 'while avoiding b' reaches where more is said",
}
"""Parts of formulas, without names, that people read differently, with the question."""
UNCLEAR = {"back", "return", "revisit", "destination"}
"""Words that leave the order open, as in 'go to a and back to b'."""


def test_unambiguous_readings_have_the_intended_meaning() -> None:
    composer = Composer(load(), Random(11))
    read, wrong = 0, []
    for _ in range(DRAWN):
        pair = composer.pair()
        meant = " ".join("x" if token in NAMES else token for token in pair.tokens)
        clear = pair.tokens[0] in "F&G" and not any(part in meant for part in DEBATABLE)
        if pair.tokens == (REFUSED,) or not clear or UNCLEAR & set(pair.words):
            continue
        said = " ".join(
            f"the {OBJECTS[NAMES.index(word)]}" if word in NAMES else word for word in pair.words
        )
        try:
            formulas = distinct(readings(said))[0]
        except TranslationError:
            continue
        if len(formulas) == 1:
            read += 1
            formula = formula_of(pair.tokens, OBJECTS)
            if distinguishing_trace(formulas[0], formula, True) is not None:
                wrong.append(f"{said} | {meant} | {to_text(formulas[0])}")
    assert read > 100
    assert not wrong, "\n".join(wrong)
