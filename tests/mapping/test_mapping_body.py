"""The robot's own shape in the map: its height, its radius, and returns from itself."""

from __future__ import annotations

import mapping_twins as twins
import numpy as np
import pytest
from mapping_twins import CAMERA, ORIGIN, T_BASE_CAMERA, look, room
from simulated import simulated

from edge.geometry import SE2, se3
from edge.mapping.grid import RollingMap
from edge.mapping.layers import OCCUPIED

NOTHING = np.full((120, 160), np.nan, np.float32)


def of_robot(**robot: float):
    mapping = {"extent_m": 9.0, "range_m": 3.0, "inflation_m": 0.0}
    return simulated({"robot": robot, "mapping": mapping})


def map_of(**robot: float) -> RollingMap:
    config = of_robot(**robot)
    return RollingMap(config.mapping, config.robot)


BAR, TABLE_TOP, KNEE = (1.1, 1.3), (0.70, 0.74), (0.2, 0.34)


@pytest.mark.parametrize(
    ("height_m", "obj", "state"),
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
def test_the_robot_passes_under_higher_obstacles(height_m, obj, state):
    grid = RollingMap(of_robot(height_m=height_m).mapping)
    low_m, high_m = obj
    look(grid, ORIGIN, [(1.5, -0.6, low_m, 2.1, 0.6, high_m), *room(2.5)])
    assert grid.state_at(1.52, 0.0) == state


def test_an_overhang_does_not_raise_the_obstacle_below_it():
    """Otherwise rays that pass between the two would clear it."""
    grid = RollingMap(of_robot(height_m=0.4).mapping)
    objects = [(1.5, -0.1, 0.0, 1.6, 0.1, 0.2), (1.5, -0.1, 0.7, 1.6, 0.1, 2.0)]
    for x in (*np.arange(0.0, 1.1, 0.1), *[1.05] * 5):
        look(grid, SE2(x, 0.0, 0.0), objects)
    assert grid.state_at(1.52, 0.0) == 100


def post(x_m: float, y_m: float, high_m: float = 0.7) -> np.ndarray:
    """(n, 3) points of a post on the base."""
    z = np.arange(0.15, high_m, 0.02)
    return np.stack([np.full_like(z, x_m), np.full_like(z, y_m), z], axis=1)


TILTED = se3(0.0, 0.0, 0.0, roll_rad=0.05, pitch_rad=0.15)


@pytest.mark.parametrize("T_base_lidar", [se3(z_m=0.4), se3(0.1, -0.1, 0.5, 0.2, 1.2, 2.0)])
@pytest.mark.parametrize("T_map_base", [np.eye(4), TILTED], ids=["upright", "tilted"])
@pytest.mark.parametrize(
    ("robot", "at_m", "closed"),
    [
        ({"radius_m": 0.2}, (0.15, 0.1), False),
        ({"radius_m": 0.2}, (0.29, 0.0), True),
        ({"radius_m": 0.5}, (0.29, 0.3), False),
        ({"radius_m": 0.2, "self_filter_m": 0.6}, (0.5, 0.0), False),
        ({"radius_m": 0.2, "self_filter_m": 0.6}, (0.7, 0.0), True),
        ({"radius_m": 0.2, "self_filter_m": 0}, (0.29, 0.0), True),
    ],
)
def test_points_within_the_robots_own_shape_are_dropped(
    robot, at_m, closed, T_map_base, T_base_lidar
):
    grid, (x, y) = map_of(**robot), at_m
    seen = np.concatenate([post(x, y), post(2.0, 0.0)])
    T = np.linalg.inv(T_base_lidar)
    cloud = (seen @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    grid.update_cloud(cloud, T_map_base, T_base_lidar)
    occupied = np.argwhere(twins.window(grid, "raw") >= OCCUPIED)[:, ::-1] + grid.window.origin
    far_m = np.linalg.norm((occupied + 0.5) * grid.resolution_m, axis=1)
    assert (far_m > 1.8).any(), "what is not the robot stays"
    assert (far_m < 1.0).any() == closed


def test_a_camera_drops_the_robots_own_body_too():
    """A box on the base in front of the camera, half in its view."""
    for radius_m, state in ((0.5, 0), (0.2, 100)):
        grid = map_of(radius_m=radius_m)
        look(grid, ORIGIN, [(0.36, -0.1, 0.3, 0.42, 0.1, 0.5)])
        assert grid.state_at(0.38, 0.0) == state


@pytest.mark.parametrize("radius_m", [0.2, 0.5])
def test_cells_under_the_robot_become_free(radius_m):
    """A closed cell stays closed if the robot only stands next to it."""
    grid = map_of(radius_m=radius_m, self_filter_m=0)
    look(grid, SE2(-1.0, 0.0, 0.0), [(-0.1, -0.1, 0.0, 0.1, 0.1, 0.5)])
    assert grid.state_at(-0.08, 0.0) == 100
    beside = -0.1 - radius_m - 0.03
    grid.update_depth(NOTHING, CAMERA, SE2(beside, 0.0, 0.0).matrix(), T_BASE_CAMERA)
    assert grid.state_at(-0.08, 0.0) == 100
    for x in np.arange(beside, 0.1, 0.05):
        grid.update_depth(NOTHING, CAMERA, SE2(x, 0.0, 0.0).matrix(), T_BASE_CAMERA)
    assert grid.state_at(-0.08, 0.0) == 0
    np.testing.assert_array_equal(twins.states(grid) == 100, twins.window(grid, "near") > 0)
