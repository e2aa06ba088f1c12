from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge.config import Mission
from edge.geometry import SE2
from edge.mission.approach import Approach
from edge.types import Goal, GoalStatus, Instance

S = 1_000_000_000
HERE = SE2(0, 0, 0)
GOAL = Goal(1, HERE, "instance", 7, (0.5, 0), 0.8, "chair")


def chair(away_m: float) -> Instance:
    point = np.array([[away_m, 0, 0.4]], np.float32)
    return Instance(7, "chair", point[0], point, 0.8, 5, 0, 0)


def answer(state: str) -> GoalStatus:
    return GoalStatus(1, state)


def test_nothing_seen_is_searching():
    approach = Approach(Mission())
    assert approach.advance(None, None, False, None, HERE, 0, 0) is None
    assert approach.phase == "searching"


@pytest.mark.parametrize(
    ("away_m", "state", "confirmed", "phase", "verdict"),
    [
        (0.5, None, True, "approaching", None),
        (0.5, "accepted", True, "approaching", None),
        # Passing or stopping beside it is not reaching it: the controller must say so.
        (0.5, "failed", True, "approaching", None),
        (0.5, "reached", True, "verifying", "reached"),
        (0.5, "reached", False, "verifying", None),
        (1.5, "reached", True, "searching", "out_of_reach"),
    ],
)
def test_what_counts_as_reached(away_m, state, confirmed, phase, verdict):
    approach = Approach(Mission())
    said = answer(state) if state else None
    got = approach.advance(GOAL, chair(away_m), confirmed, said, HERE, 0, 9)
    assert (got.kind if got else None) == verdict
    assert approach.phase == phase


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
    approach = Approach(Mission(verify_s=2.0))
    for t_s, n in looks:
        now_ns = int(t_s * S)
        verdict = approach.advance(GOAL, chair(0.5), False, answer("reached"), HERE, now_ns, n)
    assert (verdict.kind if verdict else None) == ("refuted" if refuted else None)
    assert approach.phase == "verifying"


def test_every_arrival_is_verified_afresh():
    approach = Approach(Mission(verify_s=2.0))
    for t_s, n, goal in [(0, 0, GOAL), (1, 20, None), (2.5, 30, GOAL), (4, 60, GOAL)]:
        instance = chair(0.5) if goal else None
        said = answer("reached")
        assert approach.advance(goal, instance, False, said, HERE, int(t_s * S), n) is None


def test_a_goal_that_is_reached_at_once_is_not_verified_since_the_one_before():
    approach, said = Approach(Mission(verify_s=2.0)), answer("reached")
    assert approach.advance(GOAL, chair(0.5), False, said, HERE, 0, 0) is None
    other = replace(GOAL, stamp_ns=2, candidate_id=8)
    assert approach.advance(other, chair(0.5), False, said, HERE, 3 * S, 60) is None
    assert approach.advance(other, chair(0.5), False, said, HERE, 6 * S, 90).kind == "refuted"
