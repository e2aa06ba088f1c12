"""Progress of a mission through its formula: trace, forbidden targets, rounds."""

from __future__ import annotations

from edge.config import MissionConfig
from edge.mission.progress import MissionProgress
from edge.mission.repetition import Repetition
from edge.mission.spec import prepare

IN_ORDER = "F (dock & F shelf) & (!bed W shelf)"


def progress(formula: str = IN_ORDER, repeat: Repetition | None = None) -> MissionProgress:
    return MissionProgress(prepare(MissionConfig(), formula=formula, repeat=repeat))


def test_a_trace_leads_to_acceptance_and_a_new_round_begins_again():
    run = progress(repeat=Repetition(3))
    assert (run.trace, run.accepted, run.forbidden) == ((), False, ("bed",))
    for proposition in ("dock", "shelf"):
        run.advance(proposition)
    assert (run.trace, run.accepted, run.forbidden) == (("dock", "shelf"), True, ())
    run.begin_round()
    assert (run.round, run.trace, run.accepted, run.forbidden) == (2, (), False, ("bed",))


def test_a_mission_that_does_not_repeat_leaves_nothing_out():
    run = progress()
    assert not run.leave_out("dock")
    assert run.trace == ()


def test_a_forbidden_target_is_never_left_out():
    run = progress(repeat=Repetition())
    assert not run.leave_out("bed")
    assert run.leave_out("dock")
    assert run.trace == ("dock",)


def test_not_all_targets_are_left_out_before_one_is_reached():
    run = progress("F (dock & F shelf)", Repetition())
    assert run.leave_out("dock")
    assert not run.leave_out("shelf")
    run.advance("")
    assert not run.leave_out("shelf"), "nothing was reached"
    run.advance("shelf")
    run.begin_round()
    assert run.leave_out("dock")
