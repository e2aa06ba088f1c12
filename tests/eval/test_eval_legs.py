"""What a mission's searches see again, and how straight known things are driven to."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import simulated

from edge.eval.closed_loop import ClosedLoop
from edge.eval.legs import PLACE_M, Leg, Legs, SeenFloor
from edge.geometry import Grid
from edge.sim.base import FloorPlan, free_poses
from edge.sim.worlds import load_world

RANGE_M = 5.0


def floor_of(cells: np.ndarray, hfov_deg: float = 90.0, range_m: float = 3.0) -> SeenFloor:
    plan = FloorPlan(Grid(cells.astype(np.uint8), (0.0, 0.0), 0.05))
    return SeenFloor(plan, math.radians(hfov_deg), range_m)


def test_a_look_shows_the_sector_once():
    floor = floor_of(np.zeros((200, 200)))
    new_m2, again_m2 = floor.look(5.0, 5.0, 0.3)
    assert new_m2 == pytest.approx(0.25 * math.pi * 3.0**2, rel=0.06)
    assert again_m2 == 0.0
    assert floor.look(5.0, 5.0, 0.3) == (0.0, 0.0)


def test_only_what_was_seen_before_the_leg_is_seen_again_and_that_once():
    floor = floor_of(np.zeros((200, 200)))
    first, _ = floor.look(5.0, 5.0, 0.0)
    floor.begin()
    assert floor.look(5.0, 5.0, 0.0) == pytest.approx((0.0, first))
    assert floor.look(5.0, 5.0, 0.0) == (0.0, 0.0)
    new_m2, again_m2 = floor.look(5.0, 5.0, math.pi)
    assert new_m2 == pytest.approx(first, rel=0.06)
    assert again_m2 == pytest.approx(0.0, abs=0.1)


def test_what_stands_there_hides_what_is_behind():
    cells = np.zeros((200, 200))
    cells[:, 120] = 1  # a wall at x = 6 m
    new_m2, _ = floor_of(cells).look(5.0, 5.0, 0.0)
    assert new_m2 == pytest.approx(1.0, abs=0.15)  # the triangle before it


@settings(max_examples=30)
@given(
    cells=st.lists(st.booleans(), min_size=64, max_size=64),
    x=st.floats(-1, 5),
    y=st.floats(-1, 5),
    yaw=st.floats(-7, 7),
)
def test_looks_count_each_place_once(cells, x, y, yaw):
    """Off the plan and inside things as well."""
    floor = floor_of(np.kron(np.array(cells).reshape(8, 8), np.ones((10, 10))))
    total = sum(floor.look(x, y, yaw + turn)[0] for turn in (0.0, 0.5, 0.0))
    assert total == pytest.approx((floor._seen > 0).sum() * PLACE_M**2)
    assert not (floor._seen[floor._closed] > 0).any()


def driven(instruction: str, seed: int, start=None, **more) -> tuple[ClosedLoop, list[Leg]]:
    """A mission in a generated house, and its legs."""
    world = {"kind": "generated", "seed": seed}
    sim = {"world": world, "start": start, "lockstep": True}
    mission = {"instruction": instruction, **more}
    config = simulated({"mission": mission, "sim": sim, "loop": {"lockstep": True}})
    loop = ClosedLoop(config, colour=False)
    legs = Legs(config, loop.world, RANGE_M)
    while not loop.service.status.done:
        loop.step()
        run, motion = loop.service.mission, loop.drive.motion
        known = [i.center_m[:2] for i in loop.service.tracker.of(run.target, sure=True)]
        pose = motion.pose.x_m, motion.pose.y_m, motion.pose.yaw_rad
        legs.update(run.turns, run.target, np.reshape(known, (-1, 2)), *pose, motion.path_m)
    return loop, legs.legs


def facing(seed: int, label: str, away_m: float) -> list[float]:
    """A place from where such a thing is about so far away, and straight ahead."""
    world = load_world(simulated({"sim": {"world": {"kind": "generated", "seed": seed}}}))
    thing = next(o for o in world.objects if o.label == label)
    off = [
        (abs(thing.distance_m(p.x_m, p.y_m) - away_m), p) for p in free_poses(world, 500, 0, 0.2)
    ]
    pose = min(off, key=lambda pair: pair[0])[1]
    x, y = thing.center_m[:2]
    return [pose.x_m, pose.y_m, math.atan2(y - pose.y_m, x - pose.x_m)]


def test_what_was_seen_while_another_thing_was_searched_for_is_driven_to_straight():
    start = facing(4, "bed", 1.6)
    loop, legs = driven("Reach a refrigerator, then a bed.", 4, start)
    assert loop.service.status.phase == "reached"
    search, rest = legs
    assert (search.target, search.known, rest.target, rest.known) == (
        "refrigerator", False, "bed", True,
    )  # fmt: skip
    assert search.searched_m > 3.0
    assert (rest.searched_m, rest.new_m2, rest.again_m2) == (0.0, 0.0, 0.0)
    assert rest.driven_m < 1.3 * rest.direct_m + 1.0


def test_the_second_search_does_not_explore_again_what_the_first_saw():
    loop, (first, second) = driven("Reach a toilet, then a refrigerator.", 2)
    assert loop.service.status.phase == "reached"
    assert not second.known
    assert first.new_m2 > 20.0
    assert second.again_m2 < 0.3 * first.new_m2
