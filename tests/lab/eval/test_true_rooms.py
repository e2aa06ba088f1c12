"""The true rooms of a world: which room a point is in, and where a room goal ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.geometry import Grid
from edge.lab.eval.true_rooms import distance_to_room_m, in_room_of_kind, true_room_at
from edge.lab.sim.base import FloorPlan


class _Flat:
    """A room of one rectangle, and one of two; nothing stands in them."""

    rooms = (((0.0, 0.0, 2.0, 2.0),), ((2.0, 0.0, 4.0, 1.0), (3.0, 1.0, 4.0, 2.0)))
    room_kinds: tuple[str, ...] = ("kitchen", "bedroom")
    plan = FloorPlan(Grid(np.zeros((40, 80), np.uint8), (0.0, 0.0), 0.05))


class _Unnamed(_Flat):
    room_kinds = ()


class _Full(_Flat):
    plan = FloorPlan(Grid(np.ones((40, 80), np.uint8), (0.0, 0.0), 0.05))


def test_the_true_room_of_a_point():
    points = np.array([(1, 1), (2.5, 0.5), (3.5, 1.5), (2.5, 1.5), (-1, 0)])
    assert true_room_at(_Flat(), points).tolist() == [0, 1, 1, -1, -1]
    assert true_room_at(_Flat(), np.zeros((0, 2))).tolist() == []


@pytest.mark.parametrize(
    ("world", "kind", "at_m", "distance_m"),
    [
        (_Unnamed, "kitchen", (1.0, 1.0), math.inf),
        (_Flat, "bathroom", (1.0, 1.0), math.inf),
        (_Flat, "kitchen", (1.0, 1.0), 0.0),
        (_Flat, "kitchen", (5.0, 6.0), 5.0),
        (_Flat, "bedroom", (2.5, 1.5), 0.5),
    ],
)
def test_distance_to_a_kind_of_room(world, kind, at_m, distance_m):
    assert distance_to_room_m(world(), kind, *at_m) == pytest.approx(distance_m)


def test_a_room_goal_ends_half_a_metre_inside():
    assert not in_room_of_kind(_Unnamed(), "kitchen", 0.1).any()
    found = in_room_of_kind(_Flat(), "kitchen", 0.1)
    xy_m = _Flat.plan.grid.centres_m(*np.nonzero(found))
    assert xy_m.min(axis=0) == pytest.approx([0.5, 0.5], abs=0.051)
    assert xy_m.max(axis=0) == pytest.approx([1.5, 1.5], abs=0.051)
    assert not in_room_of_kind(_Full(), "kitchen", 0.1).any()  # the robot does not fit
