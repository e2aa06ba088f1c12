"""Everyday sentences of six voices: understood, answered or refused, and never taken wrongly."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import MissionConfig, TranslatorAuto, TranslatorLtl
from edge.errors import UserError
from edge.lab.eval.everyday import SITE, everyday_cases, score_everyday
from edge.mission.instructions import translate
from edge.mission.language.intents import (
    Control,
    MemoryQuestion,
    MissionOrder,
    NoMissionError,
    SiteOrder,
    understand,
)
from edge.mission.language.remarks import is_remark
from edge.mission.language.tidy import tidy_up
from edge.mission.language.words.tokens import TranslationError, UnclearError
from edge.mission.spec import prepare

EVERYDAY = {
    "everyday": 150, "everyday_b": 149, "everyday_c": 141, "everyday_d": 150, "everyday_e": 144,
    "everyday_f": 113, "everyday_g": 124,
}  # fmt: skip
"""Name of a file of 150 sentences → least number that must be right."""
NAMES = [item.name for item in SITE.items]


@pytest.mark.parametrize(("name", "least"), EVERYDAY.items())
def test_everyday_sentences_are_mostly_right_and_never_wrong(name, least):
    cases = everyday_cases(Path(__file__).with_name(f"{name}.jsonl"))
    scores = [score_everyday(case, TranslatorAuto()) for case in cases]
    wrong = [f"{s.case['said']}: {s.got}" for s in scores if s.outcome == "wrong"]
    assert not wrong
    assert sum(s.outcome == "right" for s in scores) >= least


@pytest.mark.parametrize(
    ("said", "found"),
    [
        # Questions.
        ("Where is the mug?", MemoryQuestion("where", "mug")),
        ("where'd you last see my walking stick", MemoryQuestion("where", "walking stick")),
        ("Can you tell me where the remote control is?", MemoryQuestion("where", "remote control")),
        ("I can't find my keys, have you seen them?", MemoryQuestion("where", "keys")),
        ("Is there a wheelchair in room 3?", MemoryQuestion("exists", "wheelchair", "room 3")),
        ("Did you see a uh yellow suitcase anywhere?", MemoryQuestion("exists", "yellow suitcase")),
        ("How long ago did you see the mug?", MemoryQuestion("where", "mug")),
        ("What's your plan?", MemoryQuestion("doing")),
        ("Which rooms do you know?", MemoryQuestion("rooms")),
        ("What did you see in the office?", MemoryQuestion("seen", "", "office")),
        ("Where are you?", MemoryQuestion("self")),
        (
            "Tell me, is there a mug anywhere in the kitchen?",
            MemoryQuestion("exists", "mug", "kitchen"),
        ),
        ("As far as you know, where is the mug?", MemoryQuestion("where", "mug")),
        ("Tell me, did you see my glasses?", MemoryQuestion("exists", "glasses")),
        ("Where was the mug, last time you saw it?", MemoryQuestion("where", "mug")),
        ("You got any mugs on your map?", MemoryQuestion("exists", "mugs")),
        ("tell me what you did see", MemoryQuestion("seen")),
        ("What places do you know?", MemoryQuestion("places")),
        ("There is a mug in the office?", MemoryQuestion("exists", "mug", "office")),
        ("Any sign of the blue toolbox?", MemoryQuestion("exists", "blue toolbox")),
        ("Which room has the piano in it?", MemoryQuestion("where", "piano")),
        ("where is the where is my wallet", MemoryQuestion("where", "wallet")),
        ("Where is it my phone?", MemoryQuestion("where", "phone")),
        ("I'm hungry. Where is the fridge?", MemoryQuestion("where", "fridge")),
        ("Did you see a stretcher on your way?", MemoryQuestion("exists", "stretcher")),
        ("Any boxes left on the shelf?", MemoryQuestion("exists", "boxes on the shelf")),
        (
            "Is the mug on the table in the office?",
            MemoryQuestion("exists", "mug on the table", "office"),
        ),
        ("My keys, are they under the bed?", MemoryQuestion("exists", "keys under the bed")),
        ("The mug is still on the desk?", MemoryQuestion("exists", "mug on the desk")),
        (
            "When you came past, was there a bed in the hall?",
            MemoryQuestion("exists", "bed", "hall"),
        ),
        ("Crates under the bed, yes or no?", MemoryQuestion("exists", "crates under the bed")),
        (
            "Someone put a box by the bed, is that right?",
            MemoryQuestion("exists", "box by the bed"),
        ),
        (
            "I was wondering if there's a mug in the office",
            MemoryQuestion("exists", "mug", "office"),
        ),
        ("Which aisle's the ladder in?", MemoryQuestion("where", "ladder")),
        ("When did you last see the mug?", MemoryQuestion("where", "mug")),
        ("How far is it from here to the lift?", MemoryQuestion("where", "lift")),
        ("Does the kitchen have a kettle?", MemoryQuestion("exists", "kettle", "kitchen")),
        ("Is my bag still where you saw it?", MemoryQuestion("exists", "bag")),
        ("how many chairs did u count", MemoryQuestion("count", "chairs")),
        ("What's next to the bed?", MemoryQuestion("seen", "bed")),
        ("Where are you at the moment?", MemoryQuestion("self")),
        ("How many rooms does this flat have?", MemoryQuestion("rooms")),
        ("What are you doing?", MemoryQuestion("doing")),
        ("Why did you stop?", MemoryQuestion("doing")),
        ("Did you find it?", MemoryQuestion("doing")),
        ("How much longer?", MemoryQuestion("doing")),
        ("I can't find my keys. Have you seen them?", MemoryQuestion("exists", "keys")),
        ("When will you be back?", MemoryQuestion("doing")),
        ("What can you do?", MemoryQuestion("help")),
        ("Which rooms have a sink?", MemoryQuestion("where", "sink")),
        ("How many beds are in room 12?", MemoryQuestion("count", "beds", "room 12")),
        ("Is there a printer on this floor?", MemoryQuestion("exists", "printer")),
        ("Is there anything on the bed?", MemoryQuestion("seen", "bed")),
        ("What can you see?", MemoryQuestion("seen")),
        ("Anything in the kitchen?", MemoryQuestion("seen", "", "kitchen")),
        # Orders to learn.
        ("Remember this as the dock.", SiteOrder("place", "dock")),
        ("Call this place the reading corner.", SiteOrder("place", "reading corner")),
        ("This is the office.", SiteOrder("room", "office")),
        ("Forget the dock, we moved it.", SiteOrder("forget", "dock")),
        ("Please stay out of the bathroom, I'm having a wash.", SiteOrder("keep_out", "bathroom")),
        ("You're not allowed in the dock!", SiteOrder("keep_out", "dock")),
        ("You may go into room 6 again, the isolation is over.", SiteOrder("open", "room 6")),
        ("It's fine, you may go into room 6 again.", SiteOrder("open", "room 6")),
        ("Room 6 is clean now, you can go in there again.", SiteOrder("open", "room 6")),
        ("You never enter never the bathroom.", SiteOrder("keep_out", "bathroom")),
        ("This spot, save it as the sewing corner.", SiteOrder("place", "sewing corner")),
        ("You can forget the dock now.", SiteOrder("forget", "dock")),
        ("Stay in this room.", SiteOrder("stay_inside", "")),
        ("Aisle 3's blocked, don't go down there.", SiteOrder("keep_out", "aisle 3")),
        ("The kitchen is clean, do not go into the hall.", SiteOrder("keep_out", "hall")),
        ("Avoid the hall at all costs.", SiteOrder("keep_out", "hall")),
        ("The dock is now here.", SiteOrder("place", "dock")),
        ("The office is here", SiteOrder("room", "office")),
        ("In the bathroom you may not go.", SiteOrder("keep_out", "bathroom")),
        ("I've finished in the bathroom, so you can go in again.", SiteOrder("open", "bathroom")),
        ("It is forbidden for you to enter in the hall, always.", SiteOrder("keep_out", "hall")),
        ("I don't want you going into the hall, not ever.", SiteOrder("keep_out", "hall")),
        ("Here is the tea corner, please to memorize.", SiteOrder("place", "tea corner")),
        ("Infection's cleared, room 20 is no longer forbidden.", SiteOrder("open", "room 20")),
        ("I'd rather you never went into the hall from now on.", SiteOrder("keep_out", "hall")),
        ("It's called the den.", SiteOrder("room", "den")),
        ("Scrap the name dock.", SiteOrder("forget", "dock")),
        ("Remember this spot as home.", SiteOrder("place", "home")),
        ("Save where you're standing. Call it the base.", SiteOrder("place", "base")),
        # Control.
        ("Stop!", Control("pause")),
        ("Wait here a couple of minutes while I sit down.", Control("pause", 120.0)),
        ("okay, you can continue now", Control("resume")),
        ("Freeze, do not move!", Control("pause")),
        ("Do not move for ten seconds.", Control("pause", 10.0)),
        ("Hang on right there for ten seconds.", Control("pause", 10.0)),
        ("All clear, carry on with what you was doing.", Control("resume")),
        ("Never mind, forget it.", Control("cancel")),
        ("Forget about that task.", Control("cancel")),
        ("Stop! Do it again.", Control("pause")),
        ("Again, please!", Control("again")),
        ("Could you do that once more?", Control("again")),
        ("Try again.", Control("again")),
        ("Repeat the last mission, please.", Control("again")),
        ("Hold up, forklift coming!", Control("pause")),
        ("Pause your round for five minutes.", Control("pause", 300.0)),
        ("You can move now.", Control("resume")),
        ("Oh, stop, stop please, that's quite enough.", Control("pause")),
        ("Wait there for ten minutes, will you, while I eat.", Control("pause", 600.0)),
        ("Cancel that, I found it.", Control("cancel")),
        ("Cancel that, I don't need it any more.", Control("cancel")),
        ("Forget the whole mission.", Control("cancel")),
        ("Oh goodness, do stop, I very nearly went over you!", Control("pause")),
        ("Freeze, like in musical statues!", Control("pause")),
        ("Pause for a sec.", Control("pause")),
        ("Pause for five minutes, then keep going.", Control("pause", 300.0)),
    ],
)
def test_questions_and_direct_orders_are_recognised(said, found):
    assert understand(said, NAMES) == found
    with pytest.raises(NoMissionError) as error:
        prepare(MissionConfig(), said, site=SITE)
    assert error.value.intent == found


@pytest.mark.parametrize(
    "said",
    [
        "", "go to the bed", "stop at the bed", "stay out of the chair",
        "look for a blanket, but keep out of the kitchen", "stop, go to the dock",
        "wait two minutes, then go to the dock", "you may go into the kitchen",
        "stay out of the kitchen until you have found the mug", "do not go near the stove",
        "you are not in the kitchen", "this is not the office",
        "the kitchen is free now, you can go in there", "do not go to the kitchen before we leave",
        "you got to go to the kitchen", "tell me about the kitchen",
        "there is some bread on the desk", "you are in a very big bathroom", "it is raining",
        "this is fun", "this is the worst",
        "this place is crowded", "it is the red one", "drop the mug",
        "could you see if it is red",
        "forget everything you have seen", "forget that you saw the mug", "in the kitchen",
        "next to the bed", "do not go to the hall before you make it to the kitchen",
        "enough, now the kitchen", "stop, go to the kitchen", "the mug is here",
        "the dock is here?", "skip to the kitchen",
    ],
)  # fmt: skip
def test_errands_and_unclear_text_go_to_the_translators(said):
    assert isinstance(understand(said, NAMES), MissionOrder)


@pytest.mark.parametrize(
    "said", ["Where is the mug? Do not go there.", "Remember this as the dock, then go to the bed."]
)
def test_several_orders_at_once_are_refused(said):
    with pytest.raises(TranslationError, match="say one at a time"):
        understand(said, NAMES)


@pytest.mark.parametrize(
    "said",
    ["How big is the kitchen?", "who are you", "what time is it", "how do I get to the bed",
     "Is the door open?", "where have you been", "is the sofa red?", "is there no mug?",
     "which rooms have you not seen?", "which rooms are blocked?",
     "is it on the desk or is it broken?"],
)  # fmt: skip
def test_a_question_without_an_answer_is_refused_as_one(said):
    with pytest.raises(UnclearError, match="a question that the robot cannot answer; it can say"):
        understand(said)


@pytest.mark.parametrize("said", ["Remember the dock.", "save the mug and the bed"])
def test_an_order_to_remember_needs_a_name(said):
    with pytest.raises(TranslationError, match="unclear what to remember; say 'remember this as"):
        understand(said, NAMES)


@pytest.mark.parametrize(
    ("said", "text", "reasons"),
    [
        ("", "", ()),
        ("Um, could you please go to the bed, dear?", "go to the bed", ()),
        ("go to the kitchen uh no sorry the bathroom", "go to the bathroom", ()),
        ("find the red no the blue mug", "find the blue mug", ()),
        ("go to room 3 I mean room 4", "go to room 4", ()),
        ("go to the table, no wait, I meant the shelf", "go to the shelf", ()),
        ("find the bed... actually no, make it the sofa", "find the sofa", ()),
        ("wait at the till till I come", "wait at the till until I come", ()),
        ("go to the bed, take your time", "go to the bed", ("take your time",)),
        ("Go in the kitchen, I heard a noise!", "Go in the kitchen", ("I heard a noise",)),
        ("It's all right, go to the bed", "go to the bed", ("it is all right",)),
        ("go to the bed, all clear", "go to the bed, all clear", ()),
        ("Find the bag or the mug, you pick!", "Find the bag or the mug", ("you pick",)),
        ("find the bag, is same for me", "find the bag", ("is same",)),
        ("Track down a mug, will ya.", "Track down a mug", ()),
        ("go to, like, the bed, like a guard", "go to, the bed", ()),
        ("find a little robot", "find a little robot", ()),
        ("find the red find the red mug", "find the red mug", ()),
        ("come come here, dear, to me", "come here, to me", ()),
        ("go to the hall the bed the hall the bed", "go to the hall the bed the hall the bed", ()),
        ("Go round so you know your way.", "Go round", ("so you know your way",)),
        ("Let's play, go to the bed", "go to the bed", ("let us play",)),
        ("Go to the bed, there's lava in the hall", "Go to the bed",
         ("there is lava in the hall",)),
        ("There is a mug, find it", "There is a mug, find it", ()),
        ("find the mug, it is the red one", "find the mug, it is the red one", ()),
        ("landmark one is first, landmark two is second",
         "landmark one is first, landmark two is second", ()),
        ("Let's play pirates and you go to the bed", "go to the bed", ()),
        ("Pretend you're the castle guard and go to the bed", "go to the bed", ()),
        ("It is late so go to the bed", "go to the bed", ("It is late",)),
        ("find the mug, I don't know where it is", "find the mug", ("I do not know where it is",)),
        ("bed -> sofa", "bed, then sofa", ()),
        ("1. go to the bed. 2. the sofa", "go to the bed, then the sofa", ()),
        ("1) shelf 2.\n2) the bed", "shelf 2, then the bed", ()),
        ("- the bed\n- the sofa", "the bed, then the sofa", ()),
        ("go to room 1. then go on", "go to room 1. then go on", ()),
        ('go to "no sorry the bed"', 'go to "no sorry the bed"', ()),
    ],
)  # fmt: skip
def test_speech_is_tidied(said, text, reasons):
    speech = tidy_up(said)
    assert (speech.with_quotations(speech.text), speech.reasons) == (text, reasons)


@pytest.mark.parametrize(
    "clause",
    [
        "I do not want you there", "we visit the sofa", "I have locked the sofa",
        "there is no way through the sofa", "we are skipping the sofa", "there is also the sofa",
        "I start with the sofa", "the sofa is second", "I do not care which", "he said the sofa",
        "they are on the sofa", "I heard a noise go to the sofa", "I was wrong", "never the sofa",
        "thank you for not visiting the sofa", "I want to tell you to skip the sofa",
    ],
)  # fmt: skip
def test_a_clause_that_may_direct_the_robot_counts(clause):
    assert not is_remark(clause)
    assert tidy_up(f"Go to the bed and the sink, {clause}").reasons == ()


@pytest.mark.parametrize("remark", ["I heard the dog", "the hall is wet", "there is a mess"])
@pytest.mark.parametrize(("ban", "name"), [("the sofa", "sofa"), ("room 3", '"room three"')])
def test_a_ban_is_kept_next_to_a_remark(ban, name, remark):
    found = translate(MissionConfig(), f"Go to the bed, don't enter {ban}, {remark}.", SITE)
    assert str(found.formula) == f"F bed & G !{name}"
    assert remark in found.english


@pytest.mark.parametrize(
    "ban", ["do not do not enter", "don't uh don't enter", "never never enter"]
)
def test_a_repeated_negation_stays_one(ban):
    found = translate(MissionConfig(), f"Go to the bed, {ban} the kitchen.", SITE)
    assert str(found.formula) == "F bed & G !kitchen"


def test_a_remark_about_a_target_is_asked_about():
    with pytest.raises(TranslationError, match="says more about 'sofa'"):
        translate(MissionConfig(), "Go to the bed, don't go near the sofa, I heard the sofa.", SITE)


@pytest.mark.parametrize(
    "said", ["explore, sorry, bathroom", "go to the hall before the bed, sorry, to the sofa"]
)
def test_a_correction_of_nothing_or_of_a_condition_is_refused(said):
    with pytest.raises(TranslationError, match="unclear what this corrects"):
        tidy_up(said)


@pytest.mark.parametrize(
    ("said", "formula"),
    [
        (
            "go to the hall before you make it to the kitchen",
            "F (hall & F kitchen) & !kitchen W hall",
        ),
        ("go to the bedroom, then make it to the kitchen", "F (bedroom & F kitchen)"),
        ("stay out of the bathroom and make it to the sofa", "F sofa & G !bathroom"),
        ("find the mop, it is a blue one", 'F "blue mop"'),
    ],
)
def test_words_of_a_correction_keep_their_other_meaning(said, formula):
    assert str(translate(MissionConfig(), said).formula) == formula


@pytest.mark.parametrize(
    "said",
    [
        "go to the hall, then report once you have checked the bathroom", "find the report",
        "find my keys and tell me when you find the door", "never go to the nearest bed",
        "go to the base of the stairs", "go home depot", "explore the kitchen until I come home",
        "find the kitchen, it is big", "find my red mug, it is white", "stay on this floor in here",
        "find the bed and stay by it until I say go to the kitchen",
    ],
)  # fmt: skip
def test_no_part_of_an_order_is_lost(said):
    with pytest.raises(TranslationError):
        translate(MissionConfig(), said)


def test_a_reason_that_is_left_out_is_reported():
    found = translate(MissionConfig(), "Go to the bed, I heard a noise!")
    assert found.english == "Reach the bed. (Not part of the order: 'I heard a noise'.)"


@pytest.mark.parametrize(
    ("said", "formula", "is_remarked"),
    [
        ("Go slowly to the bed.", "F bed", True),
        ("Go to the bed, quickly.", "F bed", True),
        ("Go to the bed as fast as you can.", "F bed", True),
        ('Go to the "slow lane".', 'F "slow lane"', False),
    ],
)
def test_a_manner_is_not_promised(said, formula, is_remarked):
    translation = translate(MissionConfig(), said)
    assert str(translation.formula) == formula
    assert ("How it drives" in translation.english) is is_remarked


@pytest.mark.parametrize(
    ("said", "formula", "is_remarked"),
    [
        ("Tonight at ten, go to the bed.", 'F ("wait until 22:00" & F bed)', True),
        ("At 10 pm, go to the bed.", 'F ("wait until 22:00" & F bed)', False),
        ("Go to the bed, starting today.", "F bed", False),
    ],
)
def test_a_time_may_be_that_of_tomorrow(said, formula, is_remarked):
    translation = translate(MissionConfig(), said)
    assert str(translation.formula) == formula
    assert ("today or tomorrow" in translation.english) is is_remarked


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("at 9 am avoid the kitchen", "must begin a sequence of orders"),
        ("visit rooms 1 to 5 but not room 3", "did not understand 'to 5 but not room 3'"),
        ("go to the dock 12", "did not understand '12'"),
        ("skip the kitchen", "fulfilled by doing nothing"),
    ],
)
def test_nothing_is_lost_without_a_word(said, why):
    with pytest.raises(UserError, match=why):
        prepare(MissionConfig(), instruction=said, site=SITE)


def test_a_ban_on_haste_is_no_ban_on_the_object():
    with pytest.raises(TranslationError, match="quickly"):
        translate(MissionConfig(), "Go to the bed, but do not go to the sofa quickly.")


def test_nearest_is_not_promised():
    found = translate(MissionConfig(), "Go to the nearest chair.")
    assert str(found.formula) == "F chair"
    assert found.english.endswith("(One that it knows, else the first that it finds.)")


def test_a_formula_is_not_read_as_speech():
    config = MissionConfig(translator=TranslatorLtl())
    assert str(translate(config, "F stop").formula) == "F stop"
    said = "F (dock & F stop); repeat 3 times"  # a restart compares it
    assert translate(config, said, SITE).instruction == said


WORDS = (
    "the kitchen stay out of where is a mug remember this as dock no sorry I mean you may go again "
    "stop wait , . and"
)


@given(st.text(max_size=80) | st.lists(st.sampled_from(WORDS.split()), max_size=14).map(" ".join))
def test_any_text_is_understood_or_refused(text):
    with contextlib.suppress(TranslationError):
        assert understand(text, NAMES) == understand(f"{text} ", NAMES)
