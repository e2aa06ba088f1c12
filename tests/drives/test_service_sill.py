"""A sill that no sensor shows, in closed loop: the map learns it where the robot was held up."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from simulated import simulated

from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.mapping import layers as ly
from edge.types import GoalStatus

# Too high for the simulated robot (0.05 m), too low for the map (0.10 m).
SILL_M = 0.085


def closed_loop(folder: Path, way_round: bool, width_m: float = 1.0) -> ClosedLoop:
    """Return a robot in one of two rooms, a bed in the other, and a sill in the door between."""
    doors = [{"at_m": 1.0 + 0.5 * width_m, "width_m": width_m, "sill_m": SILL_M}]
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
                "sim": {"lockstep": True, "step_s": 0.2, "world": world},
                "sensors": {"camera": {"width_px": 160, "height_px": 128}},
                "mission": {"target": "bed"},
            }
        ),
        colour=False,
    )


def held_up(loop: ClosedLoop) -> list[str]:
    return [event for event in loop.notes.events if event.startswith("blocked")]


def test_the_robot_takes_another_path_after_one_bump(tmp_path):
    loop = closed_loop(tmp_path, way_round=True).run(100)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert loop.distance_m("bed") <= 1.0
    assert loop.drive.motion.collisions == len(held_up(loop)) == 1
    assert loop.service.status.elapsed_s < 60


def test_a_long_sill_is_given_up_after_a_few_bumps(tmp_path):
    loop = closed_loop(tmp_path, way_round=True, width_m=4.0).run(100)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert 2 <= loop.drive.motion.collisions <= 4
    assert loop.service.status.elapsed_s < 70


def test_a_blocked_only_path_ends_the_mission_with_the_reason(tmp_path):
    loop = closed_loop(tmp_path, way_round=False).run(200)
    status = loop.service.status
    assert status.phase == "failed"
    assert re.match(r"no path to the \d+ remaining frontiers,", status.reason)
    assert re.search(
        r"found no path to bed: seen at .*, no way nearer than \d\.\d m", status.reason
    )
    assert "; blocked at (3.9, 1." in status.reason
    assert loop.drive.motion.collisions <= 3
    assert status.elapsed_s < 90


@pytest.mark.parametrize("reach_cells_per_tick", [8000, 500])
def test_a_removed_obstacle_lets_the_robot_through(tmp_path, monkeypatch, reach_cells_per_tick):
    """The obstacle is a person in the only doorway, or a door that opens.

    All was looked at, so that no other view gives the reach field time to lead there.
    """
    monkeypatch.setattr("edge.mapping.grid.REACH_CELLS_PER_TICK", reach_cells_per_tick)
    loop = closed_loop(tmp_path, False)
    while not held_up(loop):
        loop.step()
    loop.service.map.grid.coverage.looks[:] = 255
    plan = loop.world.plan
    row, column = plan.grid.cell_of(4.0, 1.5)
    sill = (slice(row - 19, row + 19), slice(column - 3, column + 4))
    assert plan.grid.cells[sill].any()
    plan.grid.cells[sill] = 0
    plan.update()
    loop.run(150)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert len(held_up(loop)) == 1


@pytest.mark.parametrize(
    ("away_m", "stamp_by", "closes"),
    [(0.2, 0, True), (50.0, 0, False), (0.2, -5_000_000, False)],
    ids=["present goal", "another frame", "old goal"],
)
def test_a_controller_reports_a_nearby_obstacle_for_the_present_goal(
    tmp_path, away_m, stamp_by, closes
):
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    service, place = loop.service, loop.drive.motion.odometry.ahead(away_m)
    stamp_ns = service.goals.goal.stamp_ns + stamp_by
    service.on_goal_status(GoalStatus(stamp_ns, "accepted", blocked=place))
    service.on_goal_status(GoalStatus(stamp_ns, "accepted"))  # sent again before the next tick
    loop.step()
    assert bool(service.map.grid.bumps.closed_m) == closes
    assert len(held_up(loop)) == closes


def stand(loop: ClosedLoop, fails_after_s: float, seconds: float) -> int:
    """Run a standing robot under a controller that fails every goal after this time.

    Returns:
        how long it stood until the map closed somewhere, in nanoseconds; `seconds` at most.
    """
    service, seen = loop.service, loop.observe()
    begun_ns, goal, given_ns = seen.stamp_ns, None, 0
    for now_ns in range(begun_ns, begun_ns + int(seconds * 1e9), 500_000_000):
        before, goal = goal, service.tick(replace(seen, stamp_ns=now_ns), now_ns)
        if goal is not before:
            given_ns = now_ns
        if goal is not None:
            late = now_ns - given_ns >= fails_after_s * 1e9
            service.on_goal_status(GoalStatus(goal.stamp_ns, "failed" if late else "accepted"))
        if service.map.grid.bumps.closed_m:
            break
    return now_ns - begun_ns


@pytest.mark.parametrize(
    ("fails_after_s", "within_s"),
    [(1000.0, 3.0), (5.0, 18.0), (9.0, 18.0)],
    ids=["says nothing", "fails soon", "fails late"],
)
def test_a_stuck_robot_marks_an_obstacle_ahead(tmp_path, fails_after_s, within_s):
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    pose, stuck_s = loop.drive.motion.odometry, loop.config.mission.stuck_s
    stood_ns = stand(loop, fails_after_s, 100.0)
    ((x, y),) = loop.service.map.grid.bumps.closed_m
    assert pose.distance_to(x, y) == pytest.approx(loop.config.robot.radius_m, abs=0.05)
    assert abs(pose.bearing_to(x, y)) < 0.3
    assert stuck_s - 1.0 <= stood_ns / 1e9 <= stuck_s + within_s


def test_a_controller_without_a_path_marks_no_obstacle(tmp_path):
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    stand(loop, 0.0, 30.0)
    assert held_up(loop) == []


def test_a_known_obstacle_explains_a_standstill_only_for_a_time(tmp_path):
    """Below the mapped obstacle there may be a nearer one that the map does not show."""
    loop = closed_loop(tmp_path, way_round=False)
    while loop.drive.motion.v_mps < 0.2:
        loop.step()
    service, pose, place = loop.service, loop.drive.motion.odometry, None
    for across_m in (-0.05, 0.0, 0.05):
        cell = service.map.grid.window.cell_of(*SE2(*pose.ahead(0.4), 0.0).ahead(across_m))
        service.map.grid._cells.write(*cell, ly.OCCUPIED)
    place, said = pose.ahead(0.2), []
    for now_s in (0.0, 0.5, 10.0, 20.0):
        closed = bool(service.map.grid.bumps.closed_m)
        now_ns = loop.drive.motion.stamp_ns + int(now_s * 1e9)
        service.goals._standstill.on_blocked(service.map.grid, service.pose, place, now_ns)
        said.append(bool(service.map.grid.bumps.closed_m) and not closed)
    assert said == [False, False, False, True]
