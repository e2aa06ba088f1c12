"""Objects that move while the robot is away."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from simulated import simulated
from small_house import small_house

from edge.lab.sim.rearrange import rearrange
from edge.lab.sim.worlds import load_world

RADIUS_M = 0.2


def places(world):
    return {item.name: item.center_m for item in world.objects}


def largest_part(world, clearance_m):
    """Return the number of cells of the largest connected area."""
    free = (world.plan.clearance_m > clearance_m).astype(np.uint8)
    _, part = cv2.connectedComponents(free, connectivity=4)
    return np.bincount(part[free > 0]).max()


def test_no_share_moves_nothing(tmp_path):
    world = load_world(small_house(tmp_path))
    before = places(world)
    assert rearrange(world, 0.0, np.random.default_rng(0), world.start, RADIUS_M, ()) == []
    assert places(world) == before


@pytest.mark.parametrize("seed", range(3))
def test_moved_objects_stay_on_the_floor_and_block_no_path(seed):
    world = load_world(simulated({"sim": {"world": {"kind": "generated", "seed": seed}}}))
    before, start = places(world), world.start
    roomy_m = RADIUS_M + 0.1
    area = largest_part(world, roomy_m)
    moved = rearrange(world, 0.3, np.random.default_rng(seed), start, RADIUS_M, ("bed",))
    after = places(world)
    assert moved
    assert {name for name in before if before[name] != after[name]} == set(moved)
    for name in moved:
        assert math.dist(before[name][:2], after[name][:2]) >= 2.0
        assert before[name][2] == after[name][2]
        assert start.distance_to(*after[name][:2]) > 3 * RADIUS_M  # not onto the robot
    assert largest_part(world, roomy_m) > 0.8 * area
