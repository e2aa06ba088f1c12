"""Orders that are carried out again after a time."""

from __future__ import annotations

import pytest

from edge.config import MissionConfig, TranslatorGrammar
from edge.geometry import SE2
from edge.lab.eval.everyday import SITE
from edge.memory import Place
from edge.mission.language.words.tokens import UnclearError
from edge.mission.repetition import Repetition
from edge.mission.spec import prepare

CONFIG = MissionConfig(translator=TranslatorGrammar())


@pytest.mark.parametrize(
    ("instruction", "formula", "limit_s"),
    [
        ("check the stove every 10 minutes", 'F ("check stove" & F "wait 10 min")', None),
        ("please check the stove once every 90 s, thanks",
         'F ("check stove" & F "wait 90 s")', None),
        ("patrol the dock and the bed every 1.5 seconds",
         'F (dock & F (bed & F "wait 1.5 s"))', None),
        ("go to the bed every ten minutes but avoid the bathroom",
         'F (bed & F "wait 10 min") & G !bathroom', None),
        ("Every other hour, find the cat!", 'F (cat & F "wait 120 min")', None),
        ("visit the kitchen hourly until I tell you to stop",
         'F (kitchen & F "wait 60 min")', None),
        ("can you patrol the house every half hour for 8 hours?",
         'F ("every room" & F "wait 30 min")', 28800.0),
        ("every hour for 2 h, go to the bed, then to the sofa",
         'F (bed & F (sofa & F "wait 60 min"))', 7200.0),
        ("every minute go to the bed, then to the sofa",
         'F (bed & F (sofa & F "wait 1 min"))', None),
        ("patrol the bed and the sofa every 90 seconds",
         'F (bed & F (sofa & F "wait 90 s"))', None),
        ("go to the bed, then to the sofa, every 5 minutes",
         'F (bed & F (sofa & F "wait 5 min"))', None),
        ("Go to the bed, then check the stove. Do this every hour.",
         'F (bed & F ("check stove" & F "wait 60 min"))', None),
        ("patrol the house every hour except the kitchen",
         'F ("every room" & F "wait 60 min") & G !kitchen', None),
        ("every hour, go to the bed and wait for two minutes",
         'F (bed & F ("wait 2 min" & F "wait 60 min"))', None),
        ("every hour explore the house for ten minutes",
         'F ("explored for 10 min" & F "wait 60 min")', None),
        ("every hour, go to the bed but stay out of the kitchen",
         'F (bed & F "wait 60 min") & G !kitchen', None),
    ],
)  # fmt: skip
def test_an_order_with_a_period_repeats_with_a_wait(instruction, formula, limit_s):
    translation = prepare(CONFIG, instruction, site=SITE).translation
    assert str(translation.formula) == formula
    assert translation.repeat == Repetition(limit_s=limit_s)
    assert translation.instruction == instruction
    assert ", then wait " in translation.understood
    assert "Repeat this" in translation.understood


@pytest.mark.parametrize(
    ("instruction", "formula"),
    [
        ("every day at 8 am, go to the bed", 'F ("wait until 08:00" & F bed)'),
        ("Go to the bed every day at 8 am, please.", 'F ("wait until 08:00" & F bed)'),
        ("every morning, go to the bed at 8", 'F ("wait until 08:00" & F bed)'),
        ("every morning at 8 go to the bed, then to the sofa, but avoid the bathroom",
         'F ("wait until 08:00" & F (bed & F sofa)) & G !bathroom'),
        ("patrol the house every night at ten until I tell you to stop",
         'F ("wait until 22:00" & F "every room")'),
        ("daily at 22:00 patrol the dock and the bed",
         'F ("wait until 22:00" & F (dock & F bed))'),
        ("every day at 8 am go to the bed and wait there until noon, then come back",
         'F ("wait until 08:00" & F (bed & F ("wait until 12:00" & F here)))'),
    ],
)  # fmt: skip
def test_an_order_of_each_day_repeats_after_a_wait(instruction, formula):
    translation = prepare(CONFIG, instruction, site=SITE).translation
    assert str(translation.formula) == formula
    assert (translation.repeat, translation.instruction) == (Repetition(), instruction)


@pytest.mark.parametrize(
    ("instruction", "reason"),
    [
        ("go to the bed, then to the sofa every 5 minutes", "begin with it: 'every 5 minutes, go"),
        ("go to the bed and check the stove every 5 minutes", "begin with it"),
        ("go to the bed. Check the stove hourly", "begin with it: 'every hour, go"),
        ("Go to the bed. Check the stove. Do this every hour.", "begin with it: 'every hour, go"),
        ("look for the mug; if it is not there, go to the sofa every hour", "begin with it"),
        ("every hour check the stove. Then go home", "in one sentence"),
        ("check the stove every 10 minutes every hour", "one time between two rounds"),
        ("check the stove every 10 minutes for 5 minutes", "before the second round"),
        ("patrol the house twice every hour", "unclear what is repeated how often"),
        ("tell me what you see every 10 minutes", "only an order to drive"),
        ("don't check the stove every 10 minutes", "only an order to drive"),
        ("pause every hour", "only an order to drive"),
        ("every hour", "say what to do then"),
        ("go to the bed every day at 8 am for 2 hours", "a day has one round"),
        ("every day at 8 am and 5 pm go to the bed", "give one time"),
        ("patrol the house for an hour every night at ten", "leave out the number or time"),
        (
            "go to the bed, then to the sofa every day at 8 am",
            "begin with it: 'every day at 8:00 am, go",
        ),
        ("go to the bed at 9 am every 10 minutes", "a time of day or a time between rounds"),
        (
            "every day at 8 am, look for the mug, and if it is not there, come back",
            "expected orders in a sequence",
        ),
        ("every 10 minutes go to the bed for 2 hours", "say 'every 10 minutes for 2 hours, …'"),
    ],
)
def test_a_period_of_something_else_is_refused(instruction, reason):
    with pytest.raises(UnclearError, match=reason):
        prepare(CONFIG, instruction, site=SITE)


@pytest.mark.parametrize(
    ("instruction", "repeat"),
    [
        ("visit every room", None),
        ("explore the house for an hour", None),
        ("guard the house for an hour", Repetition(limit_s=3600.0)),
    ],
)
def test_a_time_or_every_room_is_no_period(instruction, repeat):
    assert prepare(CONFIG, instruction, site=SITE).translation.repeat == repeat


def test_the_name_of_a_place_is_no_period():
    site = SITE.with_item(Place("ring each hour", SE2(1.0, 2.0, 0.0)))
    translation = prepare(CONFIG, "go to the ring each hour", site=site).translation
    assert (str(translation.formula), translation.repeat) == ('F "ring each hour"', None)
