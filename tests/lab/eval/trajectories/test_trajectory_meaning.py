"""The rule for references: meaning of names, stopping places and passing sides."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_episodes import ROBOT_M, landmark, place

from edge.lab.eval.trajectories.references import (
    ABOUT_M,
    KINDS,
    possible_tasks,
    referring_expression,
)
from edge.lab.eval.trajectory_metrics import contacts
from edge.lab.sim.generator.rng import PortableRng

CAR, VAN = landmark(1, "car", 10.0, 0.0), landmark(2, "van", 16.0, 3.0)


def all_of(kind, *objects, walls=()):
    return list(possible_tasks(place(*objects, walls=walls), kind, PortableRng(1)))


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_place_has_no_tasks(kind):
    assert all_of(kind) == []


@pytest.mark.parametrize("kind", KINDS)
def test_an_enclosed_robot_has_no_tasks(kind):
    assert all_of(kind, CAR, VAN, walls=[(-3, 3, -3, 3)]) == []


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ([], "the car"),
        ([landmark(2, "van", 6, 4)], "the car"),
        ([landmark(2, "car", 6, 4, "blue")], "the red car"),
        ([landmark(2, "car", 6, 4, "red")], "the second car on the left"),
        ([landmark(2, "car", 6, -4, "red")], "the nearest car on the left"),
        ([landmark(2, "car", 13, 8, "red")], "the nearest car on the left"),
        # As far as the other, or too far away to count, or not: no name is clear.
        ([landmark(2, "car", 8.2, 5.8, "red")], None),
        ([landmark(2, "car", 6, 0, "red")], None),
        ([landmark(2, "car", -3, 4, "red")], None),
        ([landmark(k, "car", k, k, "red") for k in (2, 3, 4)], None),
    ],
)
def test_a_referring_expression_names_one_object(others, words):
    red = landmark(1, "car", 8.0, 6.0, "red")
    assert referring_expression(place(red, *others), red) == words


@pytest.mark.parametrize(("at", "label"), [((0.0, 9.0), "car"), ((2.0, 1.0), "car")])
def test_objects_aside_or_too_near_are_no_destination(at, label):
    assert all_of("to", landmark(1, label, *at)) == []


def test_a_reference_stops_in_front_of_the_object():
    (task,) = all_of("to", CAR)
    assert (task.instruction, task.category, task.landmarks) == ("go to the car", "specific", (1,))
    x_m, y_m = task.reference_m[-1]
    assert 9.0 - x_m == pytest.approx(ROBOT_M + ABOUT_M, abs=0.3)
    assert abs(y_m) < 0.2
    np.testing.assert_array_equal(task.reference_m[0], (0.0, 0.0))


@pytest.mark.parametrize(
    ("unseen", "certain"),
    [
        (None, True),
        ((6.5, 7.0, -1.0, 1.0), True),  # small: the robot drives around it
        ((6.6, 7.2, -20.0, 20.0), False),  # a strip before the car
    ],
)
def test_an_end_that_depends_on_unseen_ground_is_not_certain(unseen, certain):
    here, unknown = place(CAR), None
    if unseen is not None:
        at_m = here.occupancy.centres_m(*np.indices(here.drivable.shape))
        x0, x1, y0, y1 = unseen
        unknown = ((at_m > (x0, y0)) & (at_m < (x1, y1))).all(axis=-1)
        here = replace(here, drivable=here.drivable & ~unknown, unseen=unknown)
    (task,) = possible_tasks(here, "to", PortableRng(1))
    assert task.certain == certain


@pytest.mark.parametrize("kind", ["past", "around"])
def test_the_passing_side_is_the_one_in_the_instruction(kind):
    found = all_of(kind, CAR, VAN)
    assert found
    for task in found:
        k = task.landmarks[0] - 1
        sign = 1.0 if f"the left of the {('car', 'van')[k]}" in task.instruction else -1.0
        first = (CAR, VAN)[k].at_m
        abeam = task.segments[0][-1 if kind == "past" else 1]
        across = first[0] * (abeam - first)[1] - first[1] * (abeam - first)[0]
        assert sign * across > 0.0
        assert np.hypot(*(task.reference_m - abeam).T).min() < 0.2


@pytest.mark.parametrize("kind", KINDS)
def test_a_reference_runs_into_nothing(kind):
    here = place(CAR, VAN, walls=[(12.0, 13.0, -4.0, -1.0)])
    for task in possible_tasks(here, kind, PortableRng(2)):
        assert contacts(task.reference_m, here.occupancy, ROBOT_M) == 0
        assert math.dist(task.reference_m[-1], task.segments[-1][-1]) < 1e-6
