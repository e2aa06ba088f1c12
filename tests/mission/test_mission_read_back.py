"""Missions read back as orders."""

from __future__ import annotations

import pytest

from edge.config import MissionConfig
from edge.lab.eval.everyday import SITE
from edge.mission.logic.ltl import parse
from edge.mission.read_back import orders_of
from edge.mission.spec import prepare


@pytest.mark.parametrize(
    "formula", ["true", "G !bed", "F bed | F sofa", "F (bed & F (!bed & F bed))"]
)
def test_other_formulas_have_no_read_back(formula):
    assert orders_of(parse(formula), {}) == ""


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ("go to the dock and wait there for two minutes", "Go to the dock, then wait 2 min."),
        ("look around the kitchen for 90 seconds, then come back",
         "Explore the kitchen for 90 s, then come back to where this mission began."),
        ("find the mug, then return to the start", "Look for the mug, then go back to the start."),
        ("explore the house and look for the mug",
         "Explore everything; and look for the mug, in any order."),
        ("go to room 12, I heard a noise",
         "Go to room 12. (Not part of the order: 'I heard a noise'.)"),
        ("find the mug but stay out of the kitchen and avoid the dog",
         "Look for the mug. Stay out of the kitchen. Stay away from the dog."),
        ("patrol the dock and the shelf for ten minutes",
         "Go to the dock, then go to the shelf. Repeat this for 10 min."),
        ("check if the stove is in the kitchen", "Check if there is a stove in the kitchen."),
        ("clean the sofa, then turn on the tv",
         "Reach the sofa, then the television. (The robot has no arms: it only drives there.)"),
        ("go to the mug or to the dock", "Reach either the mug or the dock."),
        ("find the mug and the book", "Reach the mug and the book in any order."),
    ],
)  # fmt: skip
def test_an_instruction_is_read_back(said, text):
    english = prepare(MissionConfig(), said, site=SITE).translation.english
    assert english.replace('"', "") == text
