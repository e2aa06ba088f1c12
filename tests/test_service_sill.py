"""A sill that no sensor shows, in closed loop: the map learns it where the robot was held up."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from closed_loop import ClosedLoop
from simulated import simulated

from edge.types import GoalStatus

# Over what the simulated robot drives across (0.05 m), under what the map shows (0.10 m).
SILL_M = 0.085


def closed_loop(folder: Path, way_round: bool, policy: str = "hvl") -> ClosedLoop:
    """A robot in one of two rooms, a bed in the other; the door between them has the sill.

    Args:
        way_round: whether there is another door, farther off.
    """
    doors = [{"at_m": 1.5, "width_m": 1.0, "sill_m": SILL_M}]
    doors += [{"at_m": 6.0, "width_m": 1.0}] * way_round
    corners = [[0, 0], [8, 0], [8, 7], [0, 7], [0, 0]]
    walls = [{"start": a, "end": b} for a, b in pairwise(corners)]
    house = {
        "name": "sill",
        "start": [1.0, 1.5, 0.0],
        "rooms": [{"name": "near", "rect": [0, 0, 4, 7]}, {"name": "far", "rect": [4, 0, 8, 7]}],
        "walls": [*walls, {"start": [4, 0], "end": [4, 7], "openings": doors}],
        "objects": [{"category": "bed", "at": [7.0, 1.5], "yaw_deg": 180}],
    }
    path = folder / "house.json"
    path.write_text(json.dumps(house))
    world = {"kind": "house", "house": str(path)}
    return ClosedLoop(
        simulated(
            {
                "loop": {"lockstep": True},
                "sim": {"lockstep": True, "world": world},
                "policy": {"kind": policy},
                "mission": {"target": "bed"},
            }
        )
    )


def held_up(loop: ClosedLoop) -> list[str]:
    return [event for event in loop.notes.events if event.startswith("held up")]


@pytest.mark.parametrize("policy", ["hvl", "nearest_frontier"])
def test_it_goes_another_way_after_one_bump(tmp_path, policy):
    loop = closed_loop(tmp_path, way_round=True, policy=policy).run(100)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert loop.distance_m("bed") <= 1.0
    assert loop.drive.motion.collisions == len(held_up(loop)) == 1
    assert loop.service.status.elapsed_s < 60


def test_where_no_other_way_leads_it_tries_once_more_and_says_why_it_ends(tmp_path):
    loop = closed_loop(tmp_path, way_round=False).run(200)
    status = loop.service.status
    assert status.phase == "failed"
    assert "no way to bed; held up at (3.9, 1." in status.reason
    assert loop.drive.motion.collisions <= 3
    assert status.elapsed_s < 90


def test_what_held_it_up_may_go(tmp_path):
    """As a person does who stood in the only doorway, or a door that is opened."""
    loop = closed_loop(tmp_path, way_round=False)
    while not held_up(loop):
        loop.step()
    plan = loop.world.plan
    rows, columns = ((at - plan.origin_m[k]) / plan.cell_m for k, at in ((1, 1.5), (0, 4.0)))
    sill = (slice(int(rows) - 19, int(rows) + 19), slice(int(columns) - 3, int(columns) + 4))
    assert plan.occupied[sill].any()
    plan.occupied[sill] = 0
    plan.update()
    loop.run(150)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert len(held_up(loop)) == 1


@pytest.mark.parametrize(
    ("away_m", "stamp_by", "closes"),
    [(0.2, 0, True), (50.0, 0, False), (0.2, -1, False)],
    ids=["present goal", "another frame", "old goal"],
)
def test_any_controller_may_say_where_the_robot_is_held_up(tmp_path, away_m, stamp_by, closes):
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    service, place = loop.service, loop.drive.motion.odometry.ahead(away_m)
    stamp_ns = service.goal.stamp_ns + stamp_by
    service.goal_answered(GoalStatus(stamp_ns, "accepted", blocked=place))
    service.goal_answered(GoalStatus(stamp_ns, "accepted"))  # sent again before the next tick
    loop.step()
    assert bool(service.grid.bumps_m) == closes
    assert len(held_up(loop)) == closes


def test_a_robot_that_stands_under_a_controller_that_says_nothing_teaches_the_map(tmp_path):
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    service, seen = loop.service, loop.observe()
    stuck_ns = int(loop.config.mission.stuck_s * 1e9)
    for now_ns in range(seen.stamp_ns, seen.stamp_ns + 2 * stuck_ns, 500_000_000):
        goal = service.tick(replace(seen, stamp_ns=now_ns), now_ns)
        if goal is not None:
            service.goal_answered(GoalStatus(goal.stamp_ns, "accepted"))
        if service.grid.bumps_m:
            break
    ((x, y),) = service.grid.bumps_m
    assert seen.pose.distance_to(x, y) == pytest.approx(loop.config.robot.radius_m, abs=0.05)
    assert abs(seen.pose.bearing_to(x, y)) < 0.3
    assert now_ns - seen.stamp_ns < stuck_ns + 3 * 10**9
