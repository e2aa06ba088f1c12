"""Orders with a condition on the outcome of others, questions with an order, counts, states."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import MissionConfig, TranslatorGrammar
from edge.errors import UserError
from edge.lab.eval.everyday import SITE
from edge.mission.destinations import FailureTarget
from edge.mission.language.errands.impossible import refuse_unseen
from edge.mission.language.errands.outcomes import split_outcomes
from edge.mission.readings import AmbiguousInstructionError
from edge.mission.spec import MissionSpec, prepare

GRAMMAR = MissionConfig(translator=TranslatorGrammar())


def understood(said: str, reading: int | None = None) -> MissionSpec:
    return prepare(GRAMMAR, said, site=SITE, reading=reading)


def test_an_order_without_a_condition_has_no_branches():
    for said in ("", "go to the bed", "wait until I tell you otherwise", "check if it is there"):
        assert split_outcomes(said) is None


@pytest.mark.parametrize(
    ("said", "formula"),
    [
        # A search that fails.
        ("look for the mug in the kitchen, and if it's not there look in the hall",
         'F "mug in the kitchen" | F ("no mug in the kitchen" & F "mug in the hall")'),
        ("if you can't find the bed, come back", 'F bed | F ("no bed" & F here)'),
        ("come back if you can't find the bed", 'F bed | F ("no bed" & F here)'),
        ("if there are no chairs in the kitchen, go to the dock",
         'F "chair in the kitchen" | F ("no chair in the kitchen" & F dock)'),
        ("find the mug. If it is not on the desk, try the hall, then the kitchen.",
         'F "mug on the desk" | F ("no mug on the desk" & (F "mug in the hall" | '
         'F ("no mug in the hall" & F "mug in the kitchen")))'),
        ("find the mug in the kitchen; if it is not there, look in every room",
         'F "mug in the kitchen" | F ("no mug in the kitchen" & F mug)'),
        ("find the mug in the kitchen, otherwise visit every room",
         'F "mug in the kitchen" | F ("no mug in the kitchen" & F "every room")'),
        ("find the mug, failing that the cup, otherwise come back",
         'F mug | F ("no mug" & (F cup | F ("no cup" & F here)))'),
        ("look for the mug in the hall or else in the kitchen",
         'F "mug in the hall" | F ("no mug in the hall" & F "mug in the kitchen")'),
        ("look for the mug in the hall, then in the kitchen",
         'F "mug in the hall" | F ("no mug in the hall" & F "mug in the kitchen")'),
        ("look for the mug in the hall, and then in the kitchen; if you can't find it, come back",
         'F "mug in the hall" | F ("no mug in the hall" & (F "mug in the kitchen" | '
         'F ("no mug in the kitchen" & F here)))'),
        ("if it's not in the hall, look for the mug in the kitchen",
         'F "mug in the hall" | F ("no mug in the hall" & F "mug in the kitchen")'),
        ("find the mug or the cup; if you find neither of them, come back", None),
        ("find the mug or the cup; if you can't find either, come back",
         'F (mug | cup) | F ("no mug" & F ("no cup" & F here))'),
        ("find the mug, and if it's not there, stop", 'F mug | F "no mug"'),
        ("find the mug but avoid the dog, and if you can't find it come back",
         '(F mug | F ("no mug" & F here)) & G !dog'),
        # A place that cannot be reached.
        ("go to the kitchen, and if it's blocked go to the dock",
         'F kitchen | F ("no kitchen" & F dock)'),
        ("if the kitchen is closed, go to the dock instead",
         'F kitchen | F ("no kitchen" & F dock)'),
        ("go to the dock, else the shelf", 'F dock | F ("no dock" & F shelf)'),
        # Both outcomes.
        ("go to the kitchen; if you see a cup there, come back, otherwise go to the dock",
         'F (kitchen & (F ("cup in the kitchen" & F here) | '
         'F ("no cup in the kitchen" & F dock)))'),
        ("check if there is a bed in room 3. If so, go to it. If not, come back.",
         'F "bed in room three" | F ("no bed in room three" & F here)'),
        ("go to the dock if there's no mug in the hall, else go to the bed",
         'F ("mug in the hall" & F bed) | F ("no mug in the hall" & F dock)'),
        ("find the mug; if you find it, wait there for 2 minutes, if not go home",
         'F (mug & F "wait 120 s") | F ("no mug" & F start)'),
        ("go to the sofa, and if there's a cat on it, come back",
         'F (sofa & (F ("cat on the sofa" & F here) | F "no cat on the sofa"))'),
        ("find the mug; if you find it, come back", "F (mug & F here)"),
        ("find the ball; if it's there, go to the ball and come back",
         'F ("sports ball" & F here)'),
        ("if the ball is in the hall go to the ball, else go to the sofa",
         'F "ball in the hall" | F ("no ball in the hall" & F sofa)'),
        ("look for the mug in the hall. If it's not there, try the kitchen. Then come back.",
         'F ("mug in the hall" & F here) | '
         'F ("no mug in the hall" & F ("mug in the kitchen" & F here))'),
        ("have you seen the mug? If not, look for it", "F mug"),
        ("look for the mug; if you find it, go to the dock, then to the shelf, otherwise wait",
         'F (mug & F (dock & F shelf)) | F ("no mug" & F wait)'),
        ("look for the mug; if you find it, wait, otherwise go to the dock and come back",
         'F (mug & F wait) | F ("no mug" & F (dock & F here))'),
        ("look for the mug, otherwise go to the dock, then the bed. Either way, come back.",
         'F (mug & F here) | F ("no mug" & F (dock & F (bed & F here)))'),
        ("if there is a cup in the kitchen, find it",
         'F "cup in the kitchen" | F "no cup in the kitchen"'),
        ("go to the kitchen; if there's nobody there, wait there for 5 minutes",
         'F (kitchen & (F "person in the kitchen" | '
         'F ("no person in the kitchen" & F (kitchen & F "wait 300 s"))))'),
        ("if there is nobody in the kitchen, go there and wait",
         'F "person in the kitchen" | F ("no person in the kitchen" & F (kitchen & F wait))'),
        # Orders that hold in any case.
        ("find the mug; if it's not there go to the hall. In any case avoid the dog.",
         '(F mug | F ("no mug" & F hall)) & G !dog'),
        ("find the mug; if it's not there go to the hall. Finally come back and avoid the dog.",
         '(F (mug & F here) | F ("no mug" & F (hall & F here))) & G !dog'),
        # A rule that always holds is no branch.
        ("find the cup or the mug; if you find the cup come back",
         "F (cup | mug) & G (cup -> F here)"),
        ("go to the hall, and if you find the mug, go to the bed", "F hall & G (mug -> F bed)"),
        ("go to the kitchen; if you see a dog, come back", "F kitchen & G (dog -> F here)"),
        ("visit the bed and the sofa. If you see the dog go home.",
         "F bed & F sofa & G (dog -> F start)"),
        ("explore the house; if you find the mug come back", "F explored & G (mug -> F here)"),
        ("Go to the sofa. If you have reached the sofa, then you may go to the bed.", "F sofa"),
        ("Can you control if the fridge is in the kitchen?", 'F "check fridge in the kitchen"'),
        # An order to drive is no place to look.
        ("look for the mug in the kitchen, then go in the hall",
         'F ("mug in the kitchen" & F hall)'),
        ("look for the mug in the kitchen, go to the sofa, then in the hall, wait for two minutes",
         'F ("mug in the kitchen" & F (sofa & F (hall & F "wait 2 min")))'),
        ("look for the cup in the hall; if it's not there, look for it on the desk",
         'F "cup in the hall" | F ("no cup in the hall" & F "cup on the desk")'),
        ("find the cup in the hall; if it's not there, find it in the kitchen, then the bedroom",
         'F "cup in the hall" | F ("no cup in the hall" & (F "cup in the kitchen" | '
         'F ("no cup in the kitchen" & F "cup in the bedroom")))'),
        ("look for the cup in the hall; if it's not there, go to the kitchen and look there",
         'F "cup in the hall" | F ("no cup in the hall" & F "cup in the kitchen")'),
        ("go to the kitchen, and if you enter the hall, go to the dock",
         "F kitchen & G (hall -> F dock)"),
        ("find the cup; if it is not there, go to the dock, then find the cup",
         None),
        # A question with an order.
        ("Where is the mug? Go there.", "F mug"),
        ("find out where the mug is and go there, then come back", "F (mug & F here)"),
        ("is there a bed? if so, go to it", 'F bed | F "no bed"'),
        ("Is there a mug in the kitchen? Go to it but stay out of the hall.",
         'F "mug in the kitchen" & G !hall'),
        # Several of a kind.
        ("find two chairs, then come back", 'F ("chair 1 of 2" & F ("chair 2 of 2" & F here))'),
        ("visit both tables in the kitchen",
         'F ("table 1 of 2 in the kitchen" & F "table 2 of 2 in the kitchen")'),
    ],
)  # fmt: skip
def test_the_formula_of_an_order_with_a_condition(said, formula):
    if formula is None:
        with pytest.raises(UserError):
            understood(said)
    else:
        assert str(understood(said).translation.formula) == formula


@pytest.mark.parametrize(
    ("said", "hint"),
    [
        ("if the kitchen is blocked, go to the bathroom", "say first what to do"),
        ("if you see the cat, come back", "say first what to do"),
        ("go to the kitchen; if you see a dog, come back, otherwise wait", "say where"),
        ("go to the door; if it is closed, come back", "the robot cannot see this state"),
        ("go to the kitchen; if it is not there, come back", "unclear what this is about"),
        ("go to the sofa and the bed; if you can't find it, come back", "one sequence of orders"),
        ("go to the hall, then to the dock if the mug is there", "unclear what to do then"),
        ("find the mug, otherwise", "unclear what to do then"),
        ("if the mug is not in the hall or the den, come back", "unclear what to do then"),
        ("if the mug is not on the sofa, check the table", "say 'look on the"),
        ("find the mug, if it's not there it must be in the hall", "did not understand"),
        ("when you've found the mug come back, otherwise go to the dock", "which place or order"),
        (
            "look for the mug in the hall, if it's not there, look on the desk and avoid the dog",
            "say first what to avoid",
        ),
        ("wait for a minute; if you can't, come back", "unclear what this is about"),
        ("go to the kitchen through the hall; if it is blocked, come back", "which place or order"),
        (
            "go to the kitchen, check if the mug is there, if it isn't, come back",
            "which place or order",
        ),
        ("if the dog isn't there, go to the kitchen", "say first what to do"),
        ("find the mug or the cup; if it is not on the desk, come back", "what should be there"),
        ("go to the hall or the bed; if there is a cat on it, come back", "unclear where"),
        ("go to the dock only if you can't find the mug", "leave out the condition"),
        ("Which room has the piano? Go there.", "say one at a time"),
        ("find two scissors", "expected the name"),
        ("find the mug; if you find it, go to the dock. If you see a cup there, wait.", "unclear"),
        ("find the mug; if it's not there come back, but avoid the dog", "say first what to avoid"),
        ("find two chairs; if you can't, come back", "cannot have a fallback"),
        ("patrol the dock and the shelf for 5 minutes, otherwise come back", "what repeats"),
        ("find the mug; if it is not there, where is the cup?", "an order that has one meaning"),
        ("Where is the mug? Do not go there.", "say one at a time"),
        ("find six chairs", "expected the name"),
        ("find a free chair", "cannot see if an object is free"),
        ("go to the door that is open", "the state of an object cannot be used"),
        ("find the mug but avoid dirty tables", "cannot see if an object is dirty"),
        # "It" may be something else than the last goal.
        (
            "look for the mug in the hall; if it's not there go to the kitchen; if you can't find "
            "it come back",
            "'it': unclear which of the orders",
        ),
        (
            "find the mug; if it's not there go to the bed. If you can't find it, come back.",
            "'it': unclear which of the orders",
        ),
        (
            "find the mug, then go to the bed, and if you couldn't find it come back",
            "'it': unclear which of the orders",
        ),
        (
            "find the mug and come back; if you can't find it, wait",
            "'it': unclear which of the orders",
        ),
        ("find the mug and come back, otherwise wait", "'it': unclear which of the orders"),
        (
            "go to the kitchen and find the mug; if you can't get in, come back",
            "'it': unclear which of the orders",
        ),
        (
            "find the mug or the cup; if you find the mug go to the bed, otherwise go to the sofa",
            "'the mug': unclear which of the orders",
        ),
        (
            "find the cup or the mug; if the cup is not there go to the bed",
            "'the cup': unclear which of the orders",
        ),
        (
            "go to the kitchen or the hall; if the kitchen is closed come back",
            "'the kitchen': unclear which of the orders",
        ),
        (
            "go to the bed; if that fails go to the sofa; if that works come back",
            "'if that works': unclear which of the orders",
        ),
        (
            "find the mug; if you can't find it find the cup; if you find it come back",
            "'if you find it': unclear which of the orders",
        ),
        (
            "find the mug; if you can't find it go to the bed; if it is there, come back",
            "'if it is there': unclear which of the orders",
        ),
        (
            "find the mug on the desk; if it's not there, look on the sofa; otherwise come back",
            "'otherwise': unclear which of the orders",
        ),
        (
            "go to the dock; if you can get there go to the shelf; if you can't get there wait",
            "'if you can not get there': unclear which of the orders",
        ),
        # An order that would be lost.
        (
            "find the mug; if it's not there, look on the desk in the office",
            "unclear where to look",
        ),
        (
            "find the mug; if it isn't on the desk, go to the kitchen and look on it",
            "unclear where to look",
        ),
        (
            "find the mug; if it isn't in the hall, go to the office and search it",
            "unclear where to look",
        ),
        (
            "find the mug; if you can't find it, come back and then find it again",
            "unclear where to look",
        ),
        ("find the mug; if you can't find it, go there and wait", "'there': unclear where"),
        ("find the mug; if you can't find it stay here", "'stay here': unclear where"),
        ("find the nearest chair; if it is not in the kitchen, come back", "which place or order"),
        ("go to the mug; if it is not in the kitchen go to the sofa", "which place or order"),
        ("find the mug; if you can't find it, come back and wait there", "'there': unclear where"),
        ("go to the kitchen, then the bed if it's there, then the sofa", "unclear what to do then"),
        ("visit the bed if you can reach it, then the sofa", "unclear what to do then"),
        ("find the mug; if it's not there go to the bed twice", "only goals are understood here"),
        (
            "find the mug; if it's not there find the cup but avoid the dog; if you can't find it "
            "come back",
            "only goals are understood here",
        ),
        ("find the mug; if there isn't one in the kitchen, find a cup", "did not understand"),
        ("go to the charger; if it's not free, wait", "did not understand 'free'"),
        ("go to the dock; if it's blocked by the dog, come back", "did not understand 'blocked"),
        ("find the mug; if you can't go on, come back", "did not understand 'if you can not go on"),
        ("go home if you can't find the mug in the hall or the den", "unclear what to do then"),
        ("find the mug and the cup if they are in the kitchen", "unclear what to do then"),
        ("find the dog; if it is in the kitchen, come back", "which place or order"),
        ("find the mug in the hall; if you can't get in, come back", "unclear which of the orders"),
        ("find the mug; if it's not there wait until it is", "an order that has one meaning"),
        # Numbers of objects.
        ("find three chairs in the kitchen but not in the hall", "differ by kind"),
        ("find two dogs but avoid the dog", "expected the name"),
        ("find two chairs in the kitchen, but not in the hall", "differ by kind"),
        ("find two dogs, but avoid the dog", "one of those that you counted"),
        ("find the chair, then find two chairs", "one of those that you counted"),
        ("find two chairs, a table and a lamp", "expected the name"),
        ('find the "no entry sign"; if it is not there, come back', "may begin with 'no'"),
        ("come back; if you can't get there, wait", "this cannot fail"),
    ],
)
def test_an_unclear_condition_is_refused_in_one_line(said, hint):
    with pytest.raises(UserError, match=hint) as error:
        understood(said)
    assert "\n" not in str(error.value)


WORDS = (
    "if it is not there otherwise , . find the mug in kitchen look for then and or else come back"
)


@given(st.lists(st.sampled_from(WORDS.split()), max_size=14).map(" ".join))
def test_any_text_with_conditions_is_understood_or_refused(text):
    with contextlib.suppress(UserError):
        assert "gives up" not in understood(text).translation.english


def test_an_end_in_another_sentence_is_asked_about():
    for said in (
        "find the cup. If it isn't there, find the mug. Go to the dock.",
        "find the cup; if you find it, wait, otherwise find the mug, then go to the dock",
    ):
        with pytest.raises(AmbiguousInstructionError):
            understood(said)


def test_an_end_that_may_belong_to_the_condition_is_asked_about():
    said = "look for the mug in the hall, if it's not there try the kitchen, then come back"
    with pytest.raises(AmbiguousInstructionError) as error:
        understood(said)
    assert [reading.english for reading in error.value.readings] == [
        "Look for the mug in the hall; if it is found, come back to where this mission began; "
        "if it is not found, look for the mug in the kitchen, then come back to where this mission "
        "began.",
        "Look for the mug in the hall; if it is not found, look for the mug in the kitchen, then "
        "come back to where this mission began.",
    ]
    assert str(understood(said, 2).translation.formula) == (
        'F "mug in the hall" | F ("no mug in the hall" & F ("mug in the kitchen" & F here))'
    )


@pytest.mark.parametrize(
    ("said", "english"),
    [
        ("avoid the dog, find the mug or the cup, and if you can't find either, come back",
         "Look for the mug or look for the cup; if it is not found, come back to where this "
         "mission began. Stay away from the dog."),
        ("find the mug; if it's not there visit the sofa and the bed",
         "Look for the mug; if it is not found, look for the sofa and look for the bed, in any "
         "order."),
        ("go to the office, otherwise come back",
         "Look for the office; if that fails, come back to where this mission began."),
        ("find the mug, and if it's not there, stop",
         "Look for the mug; if it is not found, that is all."),
        ("go to the dock; if you can get there, find the mug, otherwise come back. I am busy",
         "Go to the dock; if that works, look for the mug; if that fails, come back to where this "
         "mission began. (Not part of the order: 'I am busy'.)"),
    ],
)  # fmt: skip
def test_an_order_with_a_condition_is_read_back(said, english):
    assert understood(said).translation.english == english


def test_a_place_with_more_orders_is_asked_about():
    said = "look for the mug in the kitchen, then in the hall, wait for two minutes"
    with pytest.raises(AmbiguousInstructionError) as error:
        understood(said)
    assert [str(reading.formula) for reading in error.value.readings][2:] == [
        'F ("mug in the kitchen" & F (hall & F "wait 2 min"))'
    ]


@pytest.mark.parametrize(
    "name", ["reserved sign", "open mic", "closed door sign", "dirty towel rack"]
)
def test_a_state_in_a_name_is_no_state(name):
    refuse_unseen(f"find the {name}, then a {name} board")
    with pytest.raises(UserError, match="cannot see"):
        refuse_unseen(f"find the {name.split()[0]} chair.")


def test_only_formulas_and_conditions_name_failures():
    spec = understood('find the "no entry sign" and the "entry sign"')
    assert not spec.translation.destinations
    spec = prepare(GRAMMAR, formula='F "no entry sign" & F "entry sign"', site=SITE)
    assert spec.translation.destinations == {"no entry sign": FailureTarget("entry sign")}
    assert spec.translation.english == (
        "Reach the point where the robot gives up entry sign and the entry sign in any order."
    )


@pytest.mark.parametrize(
    "formula", ['F "no here" & F here', 'F "no wait" | F wait', 'F "no no mug"']
)
def test_a_target_that_cannot_fail_has_no_failure(formula):
    with pytest.raises(UserError, match="this cannot fail; leave it out"):
        prepare(GRAMMAR, formula=formula, site=SITE)


def test_a_state_in_quotes_belongs_to_the_name():
    assert str(understood('find the "dirty table"').translation.formula) == 'F "dirty table"'
    assert understood("go to the running machine").targets == ("treadmill",)
