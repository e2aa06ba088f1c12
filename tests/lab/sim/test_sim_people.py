"""People in simulated worlds: they are seen, felt, and never walk into the robot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import Config, parse
from edge.geometry import SE2
from edge.lab.sim.base import World
from edge.lab.sim.people import PERSON_RADIUS_M, PeopledWorld, with_people
from edge.lab.sim.robot import DriveTrain
from edge.lab.sim.sensors import CameraRig
from edge.lab.sim.worlds import load_world


@pytest.fixture(scope="module")
def empty() -> World:
    return load_world(_config(0))


def _config(people: int, seed: int = 0) -> Config:
    camera = {"width_px": 160, "height_px": 128}
    return parse(
        {
            "perception": {"detector": {"kind": "sim"}},
            "sensors": {"camera": camera},
            "sim": {"people": people, "seed": seed},
        }
    )


def _walked(world: World, seed: int, seconds: float) -> tuple[PeopledWorld, float]:
    """Return a world after a time, and the least gap between the robot at its start and people."""
    config = _config(4, seed)
    peopled = with_people(world, config, world.start)
    assert isinstance(peopled, PeopledWorld)
    drive, gap_m = DriveTrain(config.robot, config.sim, peopled, world.start), math.inf
    for _ in range(round(seconds / 0.2)):
        drive.step(0.2, 0.0, 0.0)
        nearest_m = min(world.start.distance_to(*p.xy_m) for p in peopled.people)
        gap_m = min(gap_m, nearest_m - config.robot.radius_m - PERSON_RADIUS_M)
    assert drive.motion.collisions == 0
    return peopled, gap_m


def test_a_world_without_people_is_the_world_itself(empty: World) -> None:
    assert with_people(empty, _config(0), empty.start) is empty


@pytest.mark.parametrize("seed", [0, 1])
def test_walks_are_repeatable_and_avoid_a_standing_robot(empty: World, seed: int) -> None:
    (world, gap_m), (again, _) = (_walked(empty, seed, 60.0) for _ in range(2))
    places = np.array([p.xy_m for p in world.people])
    assert (places == np.array([p.xy_m for p in again.people])).all()
    assert gap_m > 0.3
    fresh = with_people(empty, _config(4, seed), empty.start)
    moved_m = [math.dist(p.xy_m, q.xy_m) for p, q in zip(fresh.people, world.people, strict=True)]
    assert moved_m[3] == 0.0, "the fourth stands"
    assert max(moved_m[:3]) > 0.5
    assert all(empty.plan.clearance_at(*xy) > 0.1 for xy in places.tolist())


def test_a_person_is_rendered_and_blocks_the_robot(empty: World) -> None:
    config = _config(4)
    world = with_people(empty, config, empty.start)
    standing = world.people[3]
    x_m, y_m = standing.xy_m.tolist()
    # A place from which a straight drive leads into the person.
    angles = np.linspace(-math.pi, math.pi, 16)
    ahead_m = config.robot.radius_m + PERSON_RADIUS_M + 0.3
    yaw = next(
        a
        for a in angles
        if world.plan.clearance_at(x_m - ahead_m * math.cos(a), y_m - ahead_m * math.sin(a))
        > config.robot.radius_m
    )
    here = SE2(x_m - ahead_m * math.cos(yaw), y_m - ahead_m * math.sin(yaw), float(yaw))
    rig = CameraRig(config, world)
    rig.look(here)
    person_id = len(empty.objects) + 4
    assert world.objects[person_id - 1].label == "person"
    seen = rig.ids == person_id
    assert seen.sum() > 500
    assert np.nanmin(rig.depth_m[seen]) < ahead_m
    drive = DriveTrain(config.robot, config.sim, world, here)
    for _ in range(10):
        drive.step(0.2, 0.5, 0.0)
    assert drive.motion.collisions == drive.motion.person_contacts == 1
    assert drive.motion.pose.distance_to(x_m, y_m) >= config.robot.radius_m + PERSON_RADIUS_M
