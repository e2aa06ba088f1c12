"""Floor plans as drawn, and the path left when a target came into view."""

from __future__ import annotations

import math

import numpy as np
import pytest
from made_outcomes import failure, record

from edge.config import load
from edge.lab.eval import geodesic
from edge.lab.eval.comparison import worlds
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.sim.worlds import load_world

RADIUS_M = 0.2


@pytest.fixture(scope="module")
def house():
    return load_world(load("demo"))


def test_the_path_left_at_first_sight_is_computed(house):
    start = [house.start.x_m, house.start.y_m, 0.0]
    here = {"world": house.name, "start": start, "trail": [start[:2], start[:2]]}
    outcomes = gather(
        [
            record("1", "a", **here, first_sight_path_m=0.0),
            failure("1", "b", **here),
            record("2", "a", **here, target="unicorn"),
            record("3", "a", **here, target=None),
            record("4", "a", **{**here, "world": "elsewhere"}),
        ]
    )
    left_m = np.full(outcomes.ran.shape, np.nan)
    inside = [e for e in range(4) if outcomes.world[e] == house.name]
    worlds.fill_left_at_sight_m(house, inside, outcomes, RADIUS_M, left_m)
    field = geodesic.distance_field(house.plan, worlds.objects_named(house, "bed"), RADIUS_M, 1.0)
    assert left_m[0, 0] == geodesic.value_at(house.plan, field, *start[:2]) > 1.0
    assert np.isnan(np.delete(left_m.ravel(), 0)).all()


def test_the_nearest_value_is_used_next_to_a_wall(house):
    field = np.full(house.plan.grid.cells.shape, np.inf)
    row, column = house.plan.grid.cell_of(house.start.x_m, house.start.y_m)
    field[row, column + 3] = 4.0
    at = np.array([house.start.x_m, house.start.y_m])
    assert worlds.nearest_value(house, field, at) == 4.0
    assert math.isnan(worlds.nearest_value(house, field, at - 5.0))
    assert math.isnan(worlds.nearest_value(house, field, at + 1000.0))
