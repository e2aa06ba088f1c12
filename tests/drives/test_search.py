"""Searching in places that are known already, in closed loop with a simulated robot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from simulated import simulated

from edge.config import Config
from edge.lab.eval.closed_loop import ClosedLoop
from edge.mission.spec import prepare

# One long room: the map sees all of it at once, the detector (2.5 m) does not.
ROOM = {
    "name": "room",
    "start": [1.0, 1.5, 0],
    "rooms": [{"name": "room", "rect": [0, 0, 9, 3]}],
    "walls": [
        {"start": a, "end": b}
        for a, b in [([0, 0], [9, 0]), ([9, 0], [9, 3]), ([9, 3], [0, 3]), ([0, 3], [0, 0])]
    ],
    "objects": [
        {"category": "armchair", "at": [2.5, 0.6], "yaw_deg": 90},
        {"category": "toilet", "at": [8.4, 2.3], "yaw_deg": 180},
        {"category": "desk", "at": [4.5, 2.6], "yaw_deg": -90},
    ],
}


def room(folder: Path, formula: str, **sections: dict) -> Config:
    file = folder / "room.json"
    file.write_text(json.dumps(ROOM))
    detector = {"kind": "sim", "max_range_m": 2.5, "false_positive_rate": 0.0}
    base = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2, "world": {"kind": "house", "house": str(file)}},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
        "mission": {"instruction": formula, "translator": {"kind": "ltl"}},
        "perception": {"detector": detector, "confirm_range_m": 2.0},
    }
    return simulated({**base, **sections})


def begin(loop: ClosedLoop, formula: str) -> ClosedLoop:
    """Another mission, to its end."""
    spec = prepare(loop.config.mission, formula=formula)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    for _ in range(3000):
        loop.step()
        if loop.service.status.done:
            return loop
    raise AssertionError(loop.service.status)


def test_an_absent_target_is_given_up_after_a_second_look(tmp_path):
    loop = ClosedLoop(room(tmp_path, "F (surfboard | piano)"), colour=False).run(200)
    status, views = loop.service.status, loop.service.goals.chooser.next_view.views
    assert status.phase == "failed"
    assert views >= 2
    again = f"looked again from {views} viewpoints"
    for target in ("surfboard", "piano"):  # one survey serves both
        assert f"explored all reachable space, {again}, found no {target}" in status.reason
    xs = [goal.pose.x_m for goal in loop.notes.goals if goal.kind == "spin"]
    assert max(xs) > 5.5  # all along the room


def test_a_later_mission_finds_an_object_that_was_not_searched_for(tmp_path):
    loop = ClosedLoop(room(tmp_path, "F armchair"), colour=False).run(100)
    assert loop.service.status.phase == "reached"
    begin(loop, "F toilet")
    assert loop.service.status.phase == "reached", loop.service.status
    assert loop.distance_m("toilet") <= 1.0
    # Then back to the first target, which the camera saw while it was not a target.
    begin(loop, "F desk")
    path_m = loop.drive.motion.pose.distance_to(2.5, 0.6)
    begin(loop, "F armchair")
    assert loop.service.status.phase == "reached", loop.service.status
    assert loop.distance_m("armchair") <= 1.0
    assert loop.service.status.path_m < path_m + 1.0
    assert {goal.kind for goal in loop.notes.goals[-2:]} == {"instance"}


def test_a_mission_that_begins_or_a_pause_ends_looking_again(tmp_path):
    loop = ClosedLoop(room(tmp_path, "F surfboard"), colour=False)
    while loop.service.goals.chooser.next_view.views == 0:
        loop.step()
    spec = prepare(loop.config.mission, formula="F piano")
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    assert loop.service.goals.chooser.next_view.views == 0
    while loop.service.goals.chooser.next_view.views == 0:
        loop.step()
    before = len(loop.notes.goals)
    loop.service.mission.pause(True)
    loop.step()
    loop.service.mission.pause(False)
    loop.run(300)
    assert loop.service.status.phase == "failed"
    stamps = [goal.stamp_ns for goal in loop.notes.goals[before:]]
    assert stamps == sorted(set(stamps))
    assert not any("replaced" in answer.reason for answer in loop.notes.goal_statuses)


@pytest.mark.parametrize("formula", ["F bed", "F television & F sofa"])
def test_without_instance_points_only_confirmed_instances_become_goals(formula):
    """The ablation "w/o IBTP" of VL-Nav: possible targets do not attract."""
    mission = {"instruction": formula, "translator": {"kind": "ltl"}}
    config = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
        "mission": mission,
    }
    loop = ClosedLoop(
        simulated({**config, "policy": {"kind": "hvl", "instances": False}}), colour=False
    )
    tracker = loop.service.map.tracker
    while not loop.service.status.done:
        loop.step()
        goal = loop.service.goals.goal
        if goal is not None and goal.kind == "instance":
            assert tracker.get(goal.candidate_id).is_confirmed
    assert loop.service.status.phase == "reached", loop.service.status
    assert loop.distance_m(loop.service.mission.target) <= 1.0
    reached = {step.label for step in loop.service.mission.log if step.kind == "reached"}
    assert reached == set(loop.service.mission.spec.targets)


@pytest.mark.parametrize("mount", [{"yaw_deg": 40.0, "roll_deg": 8.0}, {"yaw_deg": -60.0}])
def test_a_sideways_camera_finds_its_target(mount):
    sensors = {"camera": {"width_px": 160, "height_px": 128, **mount}}
    loop = ClosedLoop(
        simulated({"mission": {"target": "television"}, "sensors": sensors}), colour=False
    ).run(60)
    assert loop.service.status.phase == "reached"
    assert loop.distance_m("television") < 1.0
