"""Floor that a mission's searches see again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.geometry import Grid
from edge.lab.eval.revisits import CELL_M, RevisitCounter, SeenFloor
from edge.lab.sim.base import FloorPlan
from edge.lab.sim.worlds import load_world

RANGE_M = 5.0


def floor_of(cells: np.ndarray, hfov_deg: float = 90.0, range_m: float = 3.0) -> SeenFloor:
    plan = FloorPlan(Grid(cells.astype(np.uint8), (0.0, 0.0), 0.05))
    return SeenFloor(plan, math.radians(hfov_deg), range_m)


def test_a_view_counts_its_sector_once():
    floor = floor_of(np.zeros((200, 200)))
    new_m2, again_m2 = floor.add_view(5.0, 5.0, 0.3)
    assert new_m2 == pytest.approx(0.25 * math.pi * 3.0**2, rel=0.06)
    assert again_m2 == 0.0
    assert floor.add_view(5.0, 5.0, 0.3) == (0.0, 0.0)


def test_only_area_from_earlier_legs_counts_as_seen_again():
    floor = floor_of(np.zeros((200, 200)))
    first, _ = floor.add_view(5.0, 5.0, 0.0)
    floor.begin_leg()
    assert floor.add_view(5.0, 5.0, 0.0) == pytest.approx((0.0, first))
    assert floor.add_view(5.0, 5.0, 0.0) == (0.0, 0.0)
    new_m2, again_m2 = floor.add_view(5.0, 5.0, math.pi)
    assert new_m2 == pytest.approx(first, rel=0.06)
    assert again_m2 == pytest.approx(0.0, abs=0.1)


def test_a_wall_hides_the_area_behind_it():
    cells = np.zeros((200, 200))
    cells[:, 120] = 1  # a wall at x = 6 m
    new_m2, _ = floor_of(cells).add_view(5.0, 5.0, 0.0)
    assert new_m2 == pytest.approx(1.0, abs=0.15)  # the triangle before it


@given(
    cells=st.lists(st.booleans(), min_size=64, max_size=64),
    x=st.floats(-1, 5),
    y=st.floats(-1, 5),
    yaw=st.floats(-7, 7),
)
def test_looks_count_each_place_once(cells, x, y, yaw):
    """Off the plan and inside objects as well."""
    floor = floor_of(np.kron(np.array(cells).reshape(8, 8), np.ones((10, 10))))
    total = sum(floor.add_view(x, y, yaw + turn)[0] for turn in (0.0, 0.5, 0.0))
    assert total == pytest.approx((floor._seen > 0).sum() * CELL_M**2)
    assert not (floor._seen[floor._blocked] > 0).any()


def test_floor_counts_as_revisited_only_before_the_target_is_known():
    config = simulated({"sim": {"world": {"kind": "house", "house": "demo"}}})
    world = load_world(config)
    legs, bed = (
        RevisitCounter(config, world, RANGE_M),
        next(o for o in world.objects if o.label == "bed"),
    )
    here = world.start.x_m, world.start.y_m, world.start.yaw_rad
    nowhere, there = np.zeros((0, 2)), np.array([bed.center_m[:2]])
    legs.update(0, "sofa", nowhere, *here)
    assert legs.revisited_m2 == 0.0
    legs.update(1, "bed", there, *here)
    assert legs.revisited_m2 == 0.0
    legs.update(2, "bed", nowhere, *here)
    assert legs.revisited_m2 > 1.0
