"""The robot's own shape in the map: its height, its radius, and what it sees of itself."""

from __future__ import annotations

import mapping_twins as twins
import numpy as np
import pytest
from mapping_twins import ORIGIN, look, room
from simulated import simulated

from edge.geometry import SE2
from edge.mapping.grid import RollingMap
from edge.mapping.layers import OCCUPIED
from edge.mapping.points import TALL


def of_robot(**robot: float):
    mapping = {"extent_m": 9.0, "range_m": 3.0, "inflation_m": 0.0}
    return simulated({"robot": robot, "mapping": mapping})


BAR, TABLE_TOP, KNEE = (1.1, 1.3), (0.70, 0.74), (0.2, 0.34)


@pytest.mark.parametrize(
    ("height_m", "thing", "state"),
    [
        (0.8, BAR, 0),
        (1.5, BAR, 100),
        (1.0, BAR, 100),
        (0.8, TABLE_TOP, 100),
        (0.3, TABLE_TOP, 0),
        (0.3, KNEE, 100),
        (0.15, KNEE, 0),
    ],
)
def test_the_robot_passes_under_what_is_higher_than_itself(height_m, thing, state):
    grid = RollingMap(of_robot(height_m=height_m).mapping)
    low_m, high_m = thing
    look(grid, ORIGIN, [(1.5, -0.6, low_m, 2.1, 0.6, high_m), *room(2.5)])
    assert grid.state_at(1.52, 0.0) == state


@pytest.mark.parametrize("height_m", [0.3, 0.8])
@pytest.mark.parametrize(("high_m", "tall"), [(0.3, False), (0.6, False), (2.0, True)])
def test_a_low_robot_tells_walls_from_furniture_too(height_m, high_m, tall):
    """Rooms are cut, and sight ends, at what is tall for people, not for the robot."""
    grid = RollingMap(of_robot(height_m=height_m).mapping)
    look(grid, ORIGIN, [(1.5, -0.6, 0.0, 2.1, 0.6, high_m)])
    top = twins.window(grid, "top")[twins.window(grid, "raw") >= OCCUPIED]
    assert top.size
    assert (top.max() >= TALL) == tall


def test_an_overhang_does_not_make_what_is_under_it_higher():
    """Or rays that pass between the two would clear it."""
    grid = RollingMap(of_robot(height_m=0.4).mapping)
    things = [(1.5, -0.1, 0.0, 1.6, 0.1, 0.2), (1.5, -0.1, 0.7, 1.6, 0.1, 2.0)]
    for x in (*np.arange(0.0, 1.1, 0.1), *[1.05] * 5):
        look(grid, SE2(x, 0.0, 0.0), things)
    assert grid.state_at(1.52, 0.0) == 100
