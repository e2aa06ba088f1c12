"""Progress of a mission through its formula: letters, forbidden targets, rounds."""

from __future__ import annotations

from edge.config import MissionConfig
from edge.mission.progress import MissionProgress
from edge.mission.repetition import Repetition
from edge.mission.spec import prepare

IN_ORDER = "F (dock & F shelf) & (!bed W shelf)"


def progress(formula: str = IN_ORDER, repeat: Repetition | None = None) -> MissionProgress:
    return MissionProgress(prepare(MissionConfig(), formula=formula, repeat=repeat))


def test_letters_lead_to_acceptance_and_a_new_round_begins_again():
    way = progress(repeat=Repetition(3))
    assert (way.trace, way.accepted, way.forbidden) == ((), False, ("bed",))
    for letter in ("dock", "shelf"):
        way.advance(letter)
    assert (way.trace, way.accepted, way.forbidden) == (("dock", "shelf"), True, ())
    way.begin_round()
    assert (way.round, way.trace, way.accepted, way.forbidden) == (2, (), False, ("bed",))


def test_a_mission_that_does_not_repeat_leaves_nothing_out():
    way = progress()
    assert not way.leave_out("dock")
    assert way.trace == ()


def test_a_forbidden_target_is_never_left_out():
    way = progress(repeat=Repetition())
    assert not way.leave_out("bed")
    assert way.leave_out("dock")
    assert way.trace == ("dock",)


def test_not_all_targets_are_left_out_before_one_is_reached():
    way = progress("F (dock & F shelf)", Repetition())
    assert way.leave_out("dock")
    assert not way.leave_out("shelf")
    way.advance("")
    assert not way.leave_out("shelf"), "nothing was reached"
    way.advance("shelf")
    way.begin_round()
    assert way.leave_out("dock")
