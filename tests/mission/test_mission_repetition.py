"""Missions that repeat: a patrol with rounds, for some time, or until a stop."""

from __future__ import annotations

import pytest

from edge.config import MissionConfig
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Place, Site
from edge.mission.repetition import Repetition, split_repetition
from edge.mission.run import MissionRun
from edge.mission.spec import prepare

S = 1_000_000_000
PATROL = "F (dock & F shelf)"
SITE = Site((Place("dock", SE2(1.0, 2.0, 0.0)), Place("shelf", SE2(3.0, 2.0, 0.0))))


def begun(formula: str = PATROL, repeat: Repetition | None = None, **settings) -> MissionRun:
    config = MissionConfig(**settings)
    spec = prepare(config, formula=formula, repeat=repeat, site=SITE)
    mission = MissionRun(spec, config)
    mission.start(0)
    mission.observe(SE2(0, 0, 0), 0)
    return mission


def patrol(mission: MissionRun, stops: int, until_s: float = 0.0) -> list[str]:
    """Reach some stops, a second each; return them."""
    reached = []
    for _ in range(stops):
        reached.append(mission.target)
        mission.on_reached("there", int(until_s * S))
    return reached


@pytest.mark.parametrize(
    ("text", "rest", "repeat"),
    [
        ("", "", None),
        ("go to the bed", "go to the bed", None),
        ("do not repeat it", "do not repeat it", None),
        ("go to a, then b; repeat 3 times", "go to a, then b", Repetition(3)),
        ("go to a, then b. Repeat twelve times.", "go to a, then b", Repetition(12)),
        ("go to a; repeat for 20 min", "go to a", Repetition(limit_s=1200.0)),
        ("go to a, repeat for two hours", "go to a", Repetition(limit_s=7200.0)),
        ("go to a; repeat until told", "go to a", Repetition()),
    ],
)
def test_the_phrase_at_the_end_is_the_repetition(text, rest, repeat):
    assert split_repetition(text) == (rest, repeat)


@pytest.mark.parametrize("phrase", ["zero times", "0 times", "99999 times", "for 30 hours"])
def test_an_invalid_repetition_is_refused(phrase):
    with pytest.raises(UserError, match=r"expected a (number|time)"):
        split_repetition(f"go to a; repeat {phrase}")


@pytest.mark.parametrize(
    ("formula", "given", "one_round", "repeat"),
    [
        ("F dock & F shelf", None, "F dock & F shelf", None),
        ("G F dock & G F shelf", None, PATROL, Repetition()),
        ("G (F dock & F shelf)", None, PATROL, Repetition()),
        ("G F dock & G F shelf & G !bed", Repetition(12), f"{PATROL} & G !bed", Repetition(12)),
        (PATROL, Repetition(2), PATROL, Repetition(2)),
        ('F "every room"', Repetition(), 'F "every room"', Repetition()),
    ],
)
def test_recurrence_becomes_one_round_that_repeats(formula, given, one_round, repeat):
    spec = prepare(MissionConfig(), formula=formula, repeat=given, site=SITE)
    assert (str(spec.automaton.formula), spec.translation.repeat) == (one_round, repeat)


@pytest.mark.parametrize("formula", ["F dock", "F (dock | shelf)", "F (dock & X F dock)"])
def test_one_stop_is_not_a_round(formula):
    with pytest.raises(UserError, match="name at least two objects or places"):
        prepare(MissionConfig(), formula=formula, repeat=Repetition(), site=SITE)


def test_the_last_of_several_rounds_ends_the_mission():
    mission = begun(repeat=Repetition(3))
    assert mission.status("searching").reason == "round 1 of 3"
    assert patrol(mission, 3) == ["dock", "shelf", "dock"]
    assert mission.status("searching").reason == "round 2 of 3"
    assert (mission.progress.trace, mission.sets.reached) == (("dock",), ("dock",))
    assert patrol(mission, 1) == ["shelf"]
    assert patrol(mission, 2) == ["dock", "shelf"]
    status = mission.status("searching")
    assert (status.phase, status.reason) == ("reached", "3 rounds done")
    assert [s.text for s in mission.log if s.kind == "round"] == ["round 2 of 3", "round 3 of 3"]


def test_the_time_limit_ends_a_patrol_in_any_round():
    mission = begun(repeat=Repetition(limit_s=600.0), time_limit_s=400.0)
    mission.observe(None, 390 * S)
    mission.check_limits(390 * S)
    patrol(mission, 3, 390.0)
    assert mission.status("searching").reason == "round 2, 210 s left"
    mission.observe(None, 601 * S)
    mission.check_limits(601 * S)
    assert mission.status("searching").phase == "reached"
    assert mission.reason == "1 round done"


def test_the_limits_of_a_mission_apply_to_each_round():
    mission = begun(repeat=Repetition(), time_limit_s=10.0)
    for n in range(1, 9):
        mission.observe(None, n * 8 * S)
        mission.check_limits(n * 8 * S)
        patrol(mission, 2, n * 8)
    assert mission.status("searching").reason == "round 9"
    mission.observe(None, 80 * S)
    mission.check_limits(80 * S)
    assert (mission.status("searching").phase, mission.reason) == ("failed", "time limit of 10 s")


@pytest.mark.parametrize(
    ("repeat", "phase", "reason"),
    [(Repetition(), "reached", "cancelled; 1 round done"), (Repetition(9), "failed", "cancelled")],
)
def test_cancelling_an_endless_patrol_counts_as_reached(repeat, phase, reason):
    mission = begun(repeat=repeat)
    patrol(mission, 3)
    mission.cancel("cancelled", S)
    assert (mission.status("searching").phase, mission.reason) == (phase, reason)


def test_a_failed_stop_is_retried_in_the_next_round():
    mission = begun(repeat=Repetition(2))
    patrol(mission, 1)
    mission.abandon_target("no path", S)
    assert "left out in round 1: shelf" in [step.text for step in mission.log]
    assert patrol(mission, 2) == ["dock", "shelf"]
    assert mission.reason == "2 rounds done"


@pytest.mark.parametrize("formula", [PATROL, f"{PATROL} & G !dog"])
def test_a_patrol_fails_if_no_stop_is_reachable(formula):
    mission = begun(formula, repeat=Repetition())
    mission.abandon_target("no path to dock", S)
    assert mission.target == "shelf"
    mission.abandon_target("no path to shelf", S)
    assert mission.status("searching").phase == "failed"
    assert mission.reason == "no path to shelf"
