"""A mission with one target: what counts as reached, refuted, failed."""

from __future__ import annotations

import numpy as np
import pytest

from edge.config import Mission
from edge.geometry import SE2
from edge.mission.target import TargetMission
from edge.types import Goal, GoalStatus, Instance

S = 1_000_000_000
GOAL = Goal(1, SE2(2, 0, 0), "instance", 7, (2.5, 0), 0.6, "chair")


def chair(x: float) -> Instance:
    points = np.array([[x, 0, 0.4]], np.float32)
    return Instance(7, "chair", points[0], points, 0.6, 3, 0, 0)


def answer(state: str) -> GoalStatus:
    return GoalStatus(1, state)


def test_nothing_seen_is_searching():
    mission = TargetMission(Mission(target="chair"))
    mission.observe(SE2(0, 0, 0), 0)
    assert mission.advance(None, None, False, None, 0, 0) is None
    assert mission.status.phase == "searching"


@pytest.mark.parametrize(
    ("away_m", "state", "confirmed", "phase", "verdict"),
    [
        (0.5, None, True, "approaching", None),
        (0.5, "accepted", True, "approaching", None),
        # Passing or stopping beside it is not reaching it: the controller must say so.
        (0.5, "failed", True, "approaching", None),
        (0.5, "reached", True, "reached", "reached"),
        (0.5, "reached", False, "verifying", None),
        (1.5, "reached", True, "searching", "out_of_reach"),
    ],
)
def test_what_counts_as_reached(away_m, state, confirmed, phase, verdict):
    mission = TargetMission(Mission(target="chair"))
    mission.observe(SE2(0, 0, 0), 0)
    got = mission.advance(GOAL, chair(away_m), confirmed, answer(state) if state else None, 0, 9)
    assert (got.kind if got else None) == verdict
    assert mission.status.phase == phase


@pytest.mark.parametrize(
    ("looks", "refuted"),
    [
        # (seconds since arrival, results of the detector so far)
        ([(0, 40), (1, 45), (3, 50)], True),
        ([(0, 40), (1, 50), (1.9, 60)], False),
        # A detector that stalls, or has looked a few times only, refutes nothing.
        ([(0, 40), (3, 40), (60, 40)], False),
        ([(0, 40), (3, 44), (9, 44)], False),
        ([(0, 40), (3, 44), (9, 45)], True),
    ],
)
def test_an_instance_is_refuted_by_looks_and_time(looks, refuted):
    mission = TargetMission(Mission(target="chair", verify_s=2.0))
    mission.observe(SE2(0, 0, 0), 0)
    for t_s, n in looks:
        now_ns = int(t_s * S)
        verdict = mission.advance(GOAL, chair(0.5), False, answer("reached"), now_ns, n)
    assert (verdict.kind if verdict else None) == ("refuted" if refuted else None)
    assert mission.status.phase == "verifying"


def test_time_passes_without_a_pose():
    mission = TargetMission(Mission(target="chair", time_limit_s=10))
    for t in (5, 10, 16):
        mission.observe(None, t * S)
        mission.check_limits(False)
    assert (mission.status.phase, mission.status.reason) == ("failed", "time limit of 10 s")


@pytest.mark.parametrize(
    ("steps", "exhausted", "reason"),
    [
        ([(0, 0.0), (11, 0.1)], False, "time limit of 10 s"),
        ([(i, 0.4 * i) for i in range(9)], False, "path limit of 3 m"),
        ([(0, 0.0)], True, "explored all that can be reached, found no chair"),
    ],
)
def test_limits_end_a_mission_with_the_reason(steps, exhausted, reason):
    mission = TargetMission(Mission(target="chair", time_limit_s=10, path_limit_m=3))
    for t, x in steps:
        mission.observe(SE2(x, 0, 0), t * S)
    mission.check_limits(exhausted)
    assert (mission.status.phase, mission.status.reason) == ("failed", reason)


def test_a_pose_jump_is_not_driving():
    mission = TargetMission(Mission(target="chair"))
    for x in (0.0, 0.5, 40.0, 40.5):
        mission.observe(SE2(x, 0, 0), 0)
    assert mission.status.path_m == pytest.approx(1.0)


def test_the_end_is_final():
    mission = TargetMission(Mission(target="chair", time_limit_s=1))
    mission.observe(SE2(0, 0, 0), 0)
    mission.observe(SE2(0, 0, 0), 2 * S)
    mission.check_limits(False)
    assert mission.advance(GOAL, chair(0.1), True, answer("reached"), 3 * S, 9) is None
    mission.fail("again")
    assert (mission.status.phase, mission.status.reason) == ("failed", "time limit of 1 s")
