"""Sentences that were written to mislead the grammar.

They read like instructions and are none, or go beyond the grammar.
"""

from __future__ import annotations

import pytest

from edge.config.mission import TranslatorGrammar
from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.instruction import TranslationError, readings
from edge.mission.logic.ltl import parse
from edge.mission.readings import distinct
from edge.mission.translate import make_translator

NO_ORDERS = [
    "you are not obliged to visit the sofa",
    "you will not be required to visit the sofa",
    "stay out of the kitchen, not the bedroom",
    "if you go to the kitchen, go through the hallway",
    "every time you go to the bed, first go to the sofa",
    "when you reach the sofa you must already have visited the bed",
    "if you visit the kitchen you must have been to the bedroom before",
    "if you see the dog, go to the kitchen, then the bedroom",
    "if you see the dog, go to the kitchen while avoiding the bedroom",
    "if you see the dog, then the cat, go to the kitchen",
    "if the dog enters the kitchen, go to the bedroom",
    "you must visit the kitchen but you may skip the bedroom",
    "the kitchen can be avoided",
    "okay to pass the sofa, go to the bed",
    "avoid the kitchen or visit the bedroom",
    "avoid either the kitchen and the bedroom",
    "either the kitchen or the bedroom must be avoided",
    "you can't visit both the sofa and the bed",
    "they must not both be visited",
    "go to the sofa without visiting both the bed and the chair",
    "don't just go to the kitchen, also go to the bedroom",
    "don't go straight to the bed",
    "do not go to the kitchen now",
    "do not end in the kitchen",
    "visit the sofa, then don't visit it again until you have visited the bed",
    "go to the sofa, then avoid the bed until the chair",
    "once you've been to the chair, don't visit the sofa until you've been to the bed",
    "visit the sofa and the chair, but visit that first",
    "go to the sofa, then to the chair, then back to it",
    "pass the sofa without touching it",
    "go to the room with no window",
    "don't go anywhere except the sofa",
    "visit the sofa and the bed twice in total",
    "the robot has been to the kitchen",
    "I didn't go to the kitchen",
    "make sure the door is locked",
    "let the dog go to the kitchen",
    "watch out for the sofa",
    "the robot starts in the kitchen. go to the bed",
    "you might have visited the sofa",
    "you should have gone to the kitchen",
    "remember you visited the sofa",
    "does the robot avoid the kitchen?",
    "Take the stairs, not the elevator, to the second floor.",
    "Go to the bedroom without passing the hallway more than once.",
    "Visit the kitchen and the bedroom, but no room more than once.",
    "Do not enter the kitchen, touch the oven or open the door.",
    "Only visit the kitchen if the bedroom was not visited.",
    "Don't go to the kitchen right away.",
    "Don't go to the kitchen any more.",
    "Don't make the kitchen your last stop.",
    "The first stop is the sofa, the last stop is the bed, and the second stop is the desk.",
    "First, go to the kitchen. Third, go to the bedroom. Second, go to the bathroom.",
    "Go to the bedroom, kitchen first.",
    "Go to the bedroom after visiting first the kitchen and then the bathroom.",
    "Don't go to the kitchen and then go to the bedroom.",
    "Go to the kitchen, go to the bedroom, or go to the bathroom.",
    "Go to the kitchen and the bedroom, in that order, twice.",
    "the kitchen, then the bedroom, twice",
    "Visit the kitchen and the bedroom three times in total.",
    "Visit the kitchen and the bedroom. Visit one of them twice.",
    "Visit the kitchen exactly twice before visiting the bedroom.",
    "go to kitchen bedroom bathroom",
    "go to first floor third floor second floor",
    "You passed the kitchen. Go to the bedroom.",
    "We went to the kitchen.",
    "The guests are not allowed in the kitchen.",
    "The cat is forbidden to enter the kitchen.",
    "No thanks, go to the sofa.",
    "Clean the kitchen when you are done in the bedroom.",
    "Don't take the cup to the kitchen.",
    "Don't enter the office without coming back to the lobby.",
    "It's not necessary to go to the kitchen.",
    "It's not forbidden to enter the kitchen.",
    "The kitchen is not off limits.",
    "Don't visit the kitchen more than twice, but at least once.",
    "Go to the kitchen while I go to the bedroom.",
    "Go to the bedroom after I have been to the kitchen.",
    "The drone must avoid the tower, and the car must avoid the bridge.",
    "You will not see the sofa.",
    "The cup must not be in the kitchen.",
    "Visit the museum, not the park, and the church.",
    "Go to the kitchen, avoiding the bedroom, and the bathroom.",
    "Go to the lab, picking up the package.",
    "Later go to the kitchen, now go to the bedroom.",
    "If you go to the kitchen, the bedroom must have been visited.",
    "On your way out of the kitchen, close the door.",
    "The second time you visit the kitchen, go to the bedroom.",
    "Visit the kitchen a second time.",
    "Avoid not visiting the park.",
    "Don't rush to the kitchen.",
    "No running in the hallway.",
    "No parking at the bank.",
    "Don't cross the street at the bank.",
    "Don't use the elevator unless you're going to the fifth floor.",
    "Visit his room and her room.",
    "Go to at most two of the kitchen, the bedroom and the bathroom.",
    "Go only to the kitchen.",
    "Go to the kitchen regardless of the dog.",
    "Go to the kitchen in case you see the dog.",
    "Don't visit any room but the kitchen.",
    "You must never be in both the kitchen and the bedroom.",
    "Go to the kitchen, well, the bedroom.",
    "In the kitchen, don't touch the oven.",
]

CONTRADICTIONS = [
    "look at the kitchen but don't enter it",
    "go to the door but don't open it",
    "go to the kitchen. avoid the bedroom on the way. then go to the bathroom via the bedroom",
    "visit the kitchen, then avoid the bedroom, then visit the bathroom, then visit the bedroom",
]

MEANT = [
    ("visit the sofa, then you may visit the bed", ["F (sofa & F bed)", "F sofa"]),
    ("don't go to the bed without going to the sofa or the chair", ["!bed W (sofa | chair)"]),
    (
        "avoid the bed until you reach the chair and then go to the desk",
        ["F (chair & F desk) & !bed W chair"],
    ),
    ("while avoiding the chair, visit the sofa, then the bed", ["F (sofa & F bed) & G !chair"]),
    ("visit the sofa after the bed, and the chair after that", ["F (bed & F (sofa & F chair))"]),
    ("visit the sofa and the bed, but visit the bed last", ["F (sofa & F bed)"]),
    ("visit the sofa and the bed, ending with the sofa", ["F (bed & F sofa)"]),
    ("visit the sofa, and only if you see the dog, visit the bed", ["F sofa & F bed & !bed W dog"]),
    (
        "visit the sofa or the bed, but the bed only after the chair",
        ["F (sofa | bed) & !bed W chair"],
    ),
    ("Go to the sofa. Then go to the bed. Go back to the sofa.", ["F (sofa & F (bed & F sofa))"]),
    (
        "go to the kitchen. go to the bedroom. return to the kitchen.",
        ["F (kitchen & F (bedroom & F kitchen))"],
    ),
    (
        "Go to the kitchen, go to the bedroom, go to the kitchen again.",
        ["F (kitchen & F (bedroom & F kitchen))"],
    ),
    (
        "Go to the bedroom without entering the kitchen or touching the oven.",
        ["F bedroom & G !kitchen & G !oven"],
    ),
    (
        "Go to the sofa. Then go to the bed. After that, avoid the sofa and go to the desk.",
        ["F (sofa & F (bed & F desk)) & G (bed -> G !sofa)"],
    ),
    (
        "Go to the kitchen. After that, avoid the bedroom and go to the bathroom.",
        ["F (kitchen & F bathroom) & G (kitchen -> G !bedroom)"],
    ),
    (
        "Avoid the kitchen. Go to the bedroom. After that you may enter the kitchen.",
        ["F bedroom & G !kitchen"],
    ),
    (
        "Go to the kitchen. After that you may go to the bedroom.",
        ["F (kitchen & F bedroom)", "F kitchen"],
    ),
    ("Only after the kitchen may you enter the bedroom.", ["F bedroom & !bedroom W kitchen"]),
    (
        "Visit the kitchen, the bedroom and the bathroom, but don't visit the bathroom first.",
        ["F kitchen & F bedroom & F bathroom & !bathroom W (kitchen | bedroom)"],
    ),
    (
        "Clean the kitchen after the bedroom and the bathroom after the hallway.",
        ["F (bedroom & F kitchen) & F (hallway & F bathroom)"],
    ),
    (
        "Go past the kitchen, then the bathroom, and enter the bedroom",
        ["F (kitchen & F (bathroom & F bedroom))"],
    ),
    (
        "Go to the kitchen without the bedroom, and to the bathroom.",
        ["F kitchen & F bathroom & !bedroom W kitchen", "F kitchen & F bathroom & G !bedroom"],
    ),
    (
        "Go to the sofa. Avoid the hall. Go to the bed. Return to the sofa.",
        ["F (sofa & F (bed & F sofa)) & G !hall"],
    ),
]


@pytest.mark.parametrize("sentence", NO_ORDERS)
def test_is_refused(sentence: str) -> None:
    with pytest.raises(TranslationError):
        readings(sentence)


@pytest.mark.parametrize("sentence", CONTRADICTIONS)
def test_contradictions_are_refused(sentence: str) -> None:
    with pytest.raises(TranslationError, match="contradiction"):
        make_translator(TranslatorGrammar()).translate(sentence)


@pytest.mark.parametrize(("sentence", "formulas"), MEANT)
def test_means(sentence: str, formulas: list[str]) -> None:
    for one, expected in zip(distinct(readings(sentence))[0], formulas, strict=True):
        assert distinguishing_trace(one, parse(expected)) is None, f"{one} is not {expected}"
