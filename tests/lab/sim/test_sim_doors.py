"""Doors in simulated houses: they open and close, are seen and felt, and hit no person."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.config import Config, parse
from edge.geometry import SE2
from edge.lab.sim.base import World, WorldError
from edge.lab.sim.doors import SlidingDoor, make_doors
from edge.lab.sim.people import PeopledWorld, with_people
from edge.lab.sim.robot import DriveTrain
from edge.lab.sim.sensors import CameraRig
from edge.lab.sim.worlds import load_world

STEP_S, RADIUS_M = 0.2, 0.2
FAR = SE2(50.0, 50.0, 0.0)


def _config(doors: float) -> Config:
    return parse(
        {
            "perception": {"detector": {"kind": "sim"}},
            "sensors": {"camera": {"width_px": 160, "height_px": 128}},
            "sim": {"doors": doors, "world": {"kind": "generated", "seed": 3}},
        }
    )


@pytest.fixture(scope="module")
def house() -> World:
    return load_world(_config(0.0))


def _door() -> SlidingDoor:
    """Return an open door along x, from the origin, that is to close at once."""
    return SlidingDoor((0.0, 0.0), (1.0, 0.0), 0.9, 2.0, open_s=10.0, shut_s=10.0, clock_s=10.0)


def _shut_m(door: SlidingDoor, seconds: float, robot: SE2 = FAR, people: tuple = ()) -> float:
    for _ in range(round(seconds / STEP_S)):
        door.advance(STEP_S, robot, RADIUS_M, people)
    return door.shut_m


@pytest.mark.parametrize(("share", "some"), [(0.0, False), (0.5, True), (1.0, True)])
def test_a_share_of_the_doorways_has_doors(house: World, share: float, some: bool) -> None:
    doors = make_doors(house, share, 0, house.start)
    assert len(doors) == round(share * len(make_doors(house, 1.0, 0, house.start)))
    assert bool(doors) == some
    assert all(0.79 < door.width_m < 2.0 for door in doors)
    assert (with_people(house, _config(share), house.start) is house) == (not some)


def test_a_mesh_has_no_doors() -> None:
    with pytest.raises(WorldError, match="is a mesh"):
        make_doors(type("Mesh", (), {"name": "m"})(), 1.0, 0, FAR)


def test_a_door_closes_and_opens_again() -> None:
    door = _door()
    assert door.distance_m(0.5, 0.3) == math.inf
    assert _shut_m(door, 2.0) == door.width_m
    assert door.distance_m(0.5, 0.3) == pytest.approx(0.275)
    assert _shut_m(door, 10.0) == 0.0


@pytest.mark.parametrize(
    ("robot", "people", "closes"),
    [
        (FAR, (), True),
        (SE2(0.45, 0.3, 0.0), (), False),
        (SE2(0.45, 0.6, 0.0), (), True),
        (FAR, (np.array([0.45, 1.0]),), False),
        (FAR, (np.array([0.45, 3.0]),), True),
    ],
)
def test_a_door_yields_to_a_robot_and_opens_for_people(robot, people, closes) -> None:
    door = _door()
    assert (_shut_m(door, 2.0, robot, people) == door.width_m) == closes
    shut = _door()
    _shut_m(shut, 2.0)
    opens_for = bool(people) and not closes
    assert (_shut_m(shut, 2.0, robot, people) < shut.width_m) == opens_for


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.5, 1.4), st.floats(-1.5, 1.5), st.floats(0.0, 3.0))
def test_a_door_never_touches_a_standing_robot(x_m: float, y_m: float, wait_s: float) -> None:
    door, robot = _door(), SE2(x_m, y_m, 0.0)
    if abs(y_m) < RADIUS_M + 0.03:  # it stands in the doorway, or in the wall
        _shut_m(door, wait_s, robot)
        assert door.distance_m(x_m, y_m) > RADIUS_M


def test_a_shut_door_is_rendered_and_blocks_the_robot(house: World) -> None:
    config = _config(1.0)
    world = with_people(house, config, house.start)
    assert isinstance(world, PeopledWorld)
    door = world.doors[0]
    middle = np.add(door.jamb_m, np.multiply(0.5 * door.width_m, door.along))
    yaw = math.atan2(door.along[1], door.along[0]) + 0.5 * math.pi
    here = SE2(*(middle - 0.7 * np.array([math.cos(yaw), math.sin(yaw)])).tolist(), yaw)
    rig, middle_m = CameraRig(config, world), []
    drive = DriveTrain(config.robot, config.sim, world, here)
    for shuts in (False, True):
        door.clock_s, door.open_s, door.shut_s = 0.0, 0.0 if shuts else 99.0, 99.0
        for _ in range(10):
            world.advance(STEP_S, here)
        rig.look(here)
        middle_m.append(float(rig.depth_m[64, 80]))
        assert rig.ids[64, 80] == 0 or not shuts
    assert not middle_m[0] < 1.0
    assert middle_m[1] == pytest.approx(0.6, abs=0.05)
    for _ in range(20):
        drive.step(STEP_S, 0.5, 0.0)
    assert (drive.motion.collisions, drive.motion.person_contacts) == (1, 0)
    assert drive.motion.pose.distance_to(*middle) > config.robot.radius_m
