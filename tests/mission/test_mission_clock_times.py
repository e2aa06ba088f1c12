"""Times of day as people say them."""

from __future__ import annotations

import pytest

from edge.config import MissionConfig, TranslatorGrammar
from edge.lab.eval.everyday import SITE
from edge.mission.language.tidy import tidy_up
from edge.mission.spec import prepare


@pytest.mark.parametrize(
    ("said", "until"),
    [
        ("at 9 am", "09:00"),
        ("At 9am", "09:00"),
        ("at 9 a.m.", "09:00"),
        ("at 9:30 pm", "21:30"),
        ("at 6.30 pm", "18:30"),
        ("at nine p.m.", "21:00"),
        ("at 09:30", "09:30"),
        ("at 00:05", "00:05"),
        ("at 22:00", "22:00"),
        ("at 18 o'clock", "18:00"),
        ("at nine o'clock in the morning", "09:00"),
        ("at noon", "12:00"),
        ("at 12 noon", "12:00"),
        ("at midnight", "00:00"),
        ("at 12 am", "00:00"),
        ("at 12:30 pm", "12:30"),
        ("at half past three pm", "15:30"),
        ("at a quarter to five in the afternoon", "16:45"),
        ("at twenty-five past six in the evening", "18:25"),
        ("at ten to one pm", "12:50"),
        ("at nine thirty am", "09:30"),
        ("at nine oh five am", "09:05"),
        ("in the afternoon at 12", "12:00"),
        ("at three at night", "03:00"),
        ("tonight at ten", "22:00"),
        ("at eight tonight", "20:00"),
        ("this evening at 8", "20:00"),
        ("today at about 5 pm", "17:00"),
        ("at exactly 7 pm sharp", "19:00"),
    ],
)
def test_a_time_of_day_is_a_wait_before_its_order(said, until):
    config = MissionConfig(translator=TranslatorGrammar())
    translation = prepare(config, f"{said}, go to the dock", site=SITE).translation
    assert translation.understood.startswith(f"Wait until {until}, then go to the dock.")
    assert str(translation.formula) == f'F ("wait until {until}" & F dock)'


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ("look at five chairs", "look at five chairs"),
        ("stop at 5 doors", "stop at 5 doors"),
        ("go to the sofa at ten", "go to the sofa at ten"),
        ("every morning at 8 pm go to the bed", "every morning at 8 pm go to the bed"),
        ("go to the bed at 9 p.m. Then come back", "go to the bed at 9:00 pm. Then come back"),
        ("go to the bed at 9 pm. Then come back", "go to the bed at 9:00 pm. Then come back"),
        ("find the mug at 9.5 m", "find the mug at 9.5 m"),
        ("each evening at 6 go to the bed", "every day at 6:00 pm go to the bed"),
        ("go to the bed at 10 pm every night", "go to the bed every day at 10:00 pm"),
        ("the library around noon", "the library around noon"),
    ],
)
def test_only_a_clear_time_of_day_is_written_as_one(said, text):
    assert tidy_up(said).text == text
