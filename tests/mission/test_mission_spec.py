from __future__ import annotations

import pytest

from edge.config import MissionConfig
from edge.errors import UserError
from edge.mission.readings import AmbiguousInstructionError
from edge.mission.spec import prepare


def test_a_bare_target_becomes_a_formula():
    spec = prepare(MissionConfig(target="trash can"))
    assert str(spec.automaton.formula) == 'F "trash can"'
    assert spec.targets == ("trash can",)
    assert spec.translation.instruction == "trash can"


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("F a & G !a", ["contradiction", "F a", "G !a"]),
        ("F a & F b & (!a W b) & (!b W a)", ["contradiction", "!a W b", "!b W a"]),
        ("a & b", ["contradiction", "these parts conflict"]),
        ("F (a & b)", ["contradiction", "cannot be done"]),
        ("G !bed", ["doing nothing", "G !bed", "'stay out of the bedroom'"]),
        ("a | !a", ["doing nothing"]),
        ("X true", ["doing nothing"]),
        ("F !a", ["doing nothing"]),
        ("X !a | F b", ["doing nothing"]),
        ("G (a | !a)", ["doing nothing, whatever is reached"]),
        (" & ".join(f"F p{i}" for i in range(17)), ["17 targets", "max_targets"]),
        ("F (a", ["column"]),
    ],
)
def test_an_impossible_mission_is_refused_with_the_reason(formula, words):
    with pytest.raises(UserError) as caught:
        prepare(MissionConfig(), formula=formula)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in words), text


@pytest.mark.parametrize(
    ("said", "hint"),
    [
        ("find a", "name of the object is missing"),
        ("look for a, then wait 2 minutes", "name of the object is missing"),
        ("find a thanks", "not a known object"),
        ("find a buddy", "not a known object"),
        ("find the robot, then go to the bed", "this is the robot itself"),
        ("go to the please", "expected the name of an object"),
    ],
)
def test_an_article_or_filler_is_not_an_object(said, hint):
    with pytest.raises(UserError, match=hint):
        prepare(MissionConfig(), said)


def test_letters_may_name_objects():
    assert str(prepare(MissionConfig(), "go to a, then b").automaton.formula) == "F (a & F b)"


def test_irrelevant_objects_are_not_targets():
    spec = prepare(MissionConfig(), formula="F (chair & (bed | !bed))")
    assert spec.targets == ("chair",)
    assert spec.warnings == ("does not affect the mission: bed",)


AMBIGUOUS = "the sofa must be visited before the bed"


def test_only_requests_are_asked_about_ambiguity() -> None:
    with pytest.raises(AmbiguousInstructionError) as caught:
        prepare(MissionConfig(), AMBIGUOUS)
    shown = caught.value.details["readings"]
    assert shown == [reading.english for reading in caught.value.readings]
    spec = prepare(MissionConfig(instruction=AMBIGUOUS))
    assert spec.translation.implied
    assert spec.warnings == (
        f"the instruction has {len(shown)} readings and no person chose one, so reading 1 was "
        "taken: it fulfils all of them",
    )
    for chosen in (
        prepare(MissionConfig(), AMBIGUOUS, reading=2),
        prepare(MissionConfig(instruction=AMBIGUOUS, reading=2)),
    ):
        assert chosen.translation.english == shown[1]
        assert chosen.warnings == ()
