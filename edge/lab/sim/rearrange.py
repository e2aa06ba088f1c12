"""Moving of objects in a `BoxWorld`, as people do while a robot is away.

Evaluation uses it to test the memory of objects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from edge import names
from edge.geometry import SE2
from edge.lab.sim.base import FloorPlan, WorldObject
from edge.lab.sim.boxworld import BoxWorld

_FLOOR_M = 0.1  # an object with a lower underside stands on the floor
_GAP_M = 0.05  # smallest gap between a moved object and others
_PASS_M = 0.1  # free space on each side of the robot in a passage that must stay open
_APART_M = 2.0  # an object moves by at least this
_PLACES = 40  # random places to try for an object
_STRIDE = 4  # of the cells, each fourth row and column is checked for being near a goal
_REACH_M = 0.8  # largest distance from a goal at which it counts as reached


def rearrange(
    world: BoxWorld,
    share: float,
    rng: np.random.Generator,
    robot: SE2,
    radius_m: float,
    goals: Sequence[str],
) -> list[str]:
    """Move a share of the objects to free places on the floor; return the names of the moved ones.

    An object can move if it stands on the floor and carries nothing. It moves by 2 m or more, not
    onto the robot. An object without a place stays. No passage with room for the robot, which has
    this radius, is closed, and each goal (by name) stays reachable.
    """
    loose = [item for item in world.objects if _is_loose(item, world.objects)]
    wanted, moved = round(share * len(loose)), []
    for k in rng.permutation(len(loose)).tolist():
        if len(moved) < wanted and _move(world, loose[k], rng, robot, radius_m, goals):
            moved.append(loose[k].name)
    return moved


def _is_loose(item: WorldObject, others: Sequence[WorldObject]) -> bool:
    """Return True if an object stands on the floor and no other object is above it."""
    bottom_m, top_m = (item.center_m[2] + side * 0.5 * item.size_m[2] for side in (-1, 1))
    carries = any(
        other is not item
        and other.center_m[2] - 0.5 * other.size_m[2] > 0.5 * (bottom_m + top_m)
        and item.distance_m(*other.center_m[:2]) == 0.0
        for other in others
    )
    return bottom_m < _FLOOR_M and not carries


def _move(
    world: BoxWorld,
    item: WorldObject,
    rng: np.random.Generator,
    robot: SE2,
    radius_m: float,
    goals: Sequence[str],
) -> bool:
    """Move an object to the first of some random places at which it blocks no passage.

    Returns:
        True if it was moved.
    """
    plan, (x_m, y_m) = world.plan, item.center_m[:2]
    half_m = 0.5 * math.hypot(*item.size_m[:2])  # half of the diagonal
    before = _drivable_area(plan, radius_m)
    goals_before = _goals_in_reach(world, goals, before)
    row, col = np.nonzero(before & (plan.clearance_m > half_m + _GAP_M))
    for k in rng.integers(0, len(row), _PLACES).tolist() if len(row) else ():
        x, y = plan.grid.centres_m(row[k : k + 1], col[k : k + 1])[0].tolist()
        if math.dist((x, y), (x_m, y_m)) < _APART_M:
            continue
        if robot.distance_to(x, y) < half_m + 3.0 * radius_m:
            continue
        world.move(item.id, x, y)
        after = _drivable_area(plan, radius_m)
        # Cells that are still wide enough, but cut off from the rest.
        cut_off = before & ~after & (plan.clearance_m > radius_m + _PASS_M)
        if not cut_off.any() and goals_before <= _goals_in_reach(world, goals, after):
            return True
        world.move(item.id, x_m, y_m)
    return False


def _drivable_area(plan: FloorPlan, radius_m: float) -> np.ndarray:
    """Return (rows, columns) bool: the largest connected area with `_PASS_M` around the robot."""
    free = (plan.clearance_m > radius_m + _PASS_M).astype(np.uint8)
    _, component = cv2.connectedComponents(free, connectivity=4)
    sizes = np.bincount(component[free > 0], minlength=1)
    return (component == int(np.argmax(sizes))) & (free > 0)


def _goals_in_reach(world: BoxWorld, goals: Sequence[str], reachable: np.ndarray) -> set[str]:
    """Return the names of the goals that have an object next to a reachable cell."""
    row, col = np.nonzero(reachable[::_STRIDE, ::_STRIDE])
    xy_m = world.plan.grid.centres_m(_STRIDE * row, _STRIDE * col)
    found = set()
    for item in world.objects:
        for goal in goals:
            if goal not in found and names.same_name(item.label, goal):
                reach_m = 0.5 * math.hypot(*item.size_m[:2]) + 1.0  # rough test first: it is cheap
                close = np.hypot(*(xy_m - item.center_m[:2]).T) <= reach_m
                if any(item.distance_m(x, y) <= _REACH_M for x, y in xy_m[close].tolist()):
                    found.add(goal)
    return found
