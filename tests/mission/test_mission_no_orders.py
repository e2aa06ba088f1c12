"""What reads like an order and is none, and what reaches further than can be told: sentences of
those who set out to have the grammar misread them."""

from __future__ import annotations

import pytest

from edge.config.mission import TranslatorGrammar
from edge.eval.languages import difference
from edge.mission.language.grammar import TranslationError, readings
from edge.mission.ltl import parse
from edge.mission.readings import distinct
from edge.mission.translate import make_translator

NO_ORDERS = [
    "you don't always have to visit the sofa",
    "you are not obliged to visit the sofa",
    "you will not be required to visit the sofa",
    "avoid the sofa but not the bed",
    "stay out of the kitchen, not the bedroom",
    "if you go to the kitchen, go through the hallway",
    "when you go to the kitchen, go through the hallway first",
    "every time you go to the bed, first go to the sofa",
    "when you reach the sofa you must already have visited the bed",
    "if you visit the kitchen you must have been to the bedroom before",
    "if you see the dog, go to the kitchen, then the bedroom",
    "if you see the dog, go to the kitchen, and go to the bedroom",
    "if you see the dog, don't go to the kitchen, go to the bedroom",
    "if you see the dog, go to the kitchen while avoiding the bedroom",
    "if you see the dog, then the cat, go to the kitchen",
    "if the dog enters the kitchen, go to the bedroom",
    "if you see the dog after the cat, go to the kitchen",
    "if you see the dog, go to the kitchen after the bedroom",
    "you may visit the kitchen and then visit the bedroom",
    "you can go to the kitchen and clean it",
    "if you see the dog you can go to the kitchen, then go to the bedroom",
    "you must visit the kitchen but you may skip the bedroom",
    "you can avoid the kitchen",
    "the kitchen can be avoided",
    "okay to pass the sofa, go to the bed",
    "avoid the kitchen or visit the bedroom",
    "avoid either the kitchen and the bedroom",
    "either the kitchen or the bedroom must be avoided",
    "you can't visit both the sofa and the bed",
    "they must not both be visited",
    "go to the sofa without visiting both the bed and the chair",
    "not all of the sofa, the bed and the chair must be visited",
    "not every room must be visited",
    "don't just go to the kitchen, also go to the bedroom",
    "not only visit the sofa but also visit the bed",
    "don't only visit the kitchen",
    "you can't just go to the sofa",
    "don't always go to the kitchen",
    "don't go directly from the sofa to the bed",
    "don't go from the sofa to the bed",
    "don't go straight to the bed",
    "do not go to the kitchen now",
    "visit the sofa and the bed but don't finish at the bed",
    "do not end in the kitchen",
    "visit the sofa, then don't visit it again until you have visited the bed",
    "go to the sofa, then avoid the bed until the chair",
    "once you've been to the chair, don't visit the sofa until you've been to the bed",
    "visit the sofa and the chair, but visit that first",
    "visit the sofa, the bed and the chair. visit it last",
    "go to the sofa, then to the chair, then back to it",
    "go to the sofa and the bed. avoid it",
    "pass the sofa without touching it",
    "look into the kitchen without entering it",
    "go to the room with no window",
    "don't go anywhere except the sofa",
    "go to the sofa or go to the bed, then go to the chair",
    "visit the sofa and the bed twice in total",
    "I cleaned the kitchen, so clean the bedroom",
    "go to the kitchen, you already visited the bedroom",
    "the robot has been to the kitchen",
    "the robot has not visited the sofa, so visit it",
    "I didn't go to the kitchen",
    "you never visited the kitchen",
    "the door is locked, so go to the kitchen",
    "the window is open",
    "make sure the door is locked",
    "the dog went to the kitchen",
    "let the dog go to the kitchen",
    "be careful in the kitchen",
    "I have a sofa",
    "watch out for the sofa",
    "the robot starts in the kitchen. go to the bed",
    "you might have visited the sofa",
    "you should have gone to the kitchen",
    "remember you visited the sofa",
    "did you find the sofa?",
    "have you seen the dog?",
    "do you see the sofa?",
    "has the robot visited the sofa",
    "do I have to visit the kitchen?",
    "can I go to the kitchen?",
    "should we visit the sofa first or the bed",
    "is it required to visit the sofa",
    "didn't you visit the kitchen?",
    "won't you visit the kitchen",
    "can't you go to the kitchen",
    "does the robot avoid the kitchen?",
    "Take the stairs, not the elevator, to the second floor.",
    "Go through the hallway, not the kitchen, to the bedroom",
    "Go to the bedroom without passing the hallway more than once.",
    "Go to the kitchen without visiting any room twice.",
    "Visit the kitchen and the bedroom, but no room more than once.",
    "Do not enter the kitchen, touch the oven or open the door.",
    "Whenever you go to the kitchen, you must go to the bedroom first.",
    "Only visit the kitchen if the bedroom was not visited.",
    "Go to the kitchen only if you haven't been to the bedroom",
    "If you go to the kitchen, then the bedroom, then go to the bathroom.",
    "If you go to the kitchen after the bedroom, go to the bathroom.",
    "Visit the kitchen and don't go there again until you have been to the bedroom.",
    "visit the kitchen and don't return until the bedroom is visited",
    "Go to the bedroom, then avoid the kitchen until you reach the bathroom.",
    "Don't go directly to the kitchen, go via the hallway.",
    "Don't go to the kitchen right away.",
    "Don't go to the kitchen any more.",
    "Never go to the kitchen again.",
    "Don't make the kitchen your last stop.",
    "Your last stop is the kitchen. Go to the bedroom.",
    "Make the bedroom your last stop and go to the kitchen.",
    "The first stop is the sofa, the last stop is the bed, and the second stop is the desk.",
    "First, go to the kitchen. Third, go to the bedroom. Second, go to the bathroom.",
    "Go to the bedroom, kitchen first.",
    "Go to the bedroom after visiting first the kitchen and then the bathroom.",
    "After the hallway, then the kitchen, go to the bedroom.",
    "Before you go to the bedroom, go to the hallway and then to the kitchen.",
    "Do not go from the kitchen to the bedroom.",
    "Don't go to the kitchen and then go to the bedroom.",
    "Go to the kitchen, go to the bedroom, or go to the bathroom.",
    "Go to the kitchen or go to the bedroom, but avoid the bathroom.",
    "Go to the kitchen and the bedroom, in that order, twice.",
    "the kitchen, then the bedroom, twice",
    "Visit the kitchen and the bedroom three times in total.",
    "Visit the kitchen and the bedroom. Visit one of them twice.",
    "Visit the kitchen exactly twice before visiting the bedroom.",
    "go to the kitchen no the bedroom",
    "go to kitchen bedroom bathroom",
    "go to first floor third floor second floor",
    "Go to the first bed and second bed.",
    "Visit the first chair and second chair.",
    "Have you visited the kitchen?",
    "You passed the kitchen. Go to the bedroom.",
    "You haven't visited the kitchen. Go there.",
    "We went to the kitchen.",
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
    ("don't go to the kitchen or go to the bedroom", ["G !kitchen & G !bedroom"]),
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
    ("Go to the kitchen and the bedroom. The kitchen comes last.", ["F (bedroom & F kitchen)"]),
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
]


@pytest.mark.parametrize("sentence", NO_ORDERS)
def test_is_refused(sentence: str) -> None:
    with pytest.raises(TranslationError):
        readings(sentence)


@pytest.mark.parametrize("sentence", CONTRADICTIONS)
def test_nothing_fulfils_it(sentence: str) -> None:
    with pytest.raises(TranslationError, match="nothing fulfils it"):
        make_translator(TranslatorGrammar()).translate(sentence)


@pytest.mark.parametrize(("sentence", "formulas"), MEANT)
def test_means(sentence: str, formulas: list[str]) -> None:
    for one, expected in zip(distinct(readings(sentence))[0], formulas, strict=True):
        assert difference(one, parse(expected)) is None, f"{one} is not {expected}"
