"""Ground of a scene that a robot can reach."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_scenes import LAWN, RESOLUTION_M, ROAD, STREET, Thing, street

from edge.geometry import SE2
from edge.tasks.scene.ground import ESCAPE_M, ground_of
from edge.tasks.scene.value_map import PathMargins, value_map

CLEAR_M = 0.3
HOUSE = ((3.0, 8.0, -3.0, -2.6), (3.0, 8.0, 2.6, 3.0), (3.0, 3.4, -3.0, 3.0), (7.6, 8.0, -3.0, 3.0))


def test_an_empty_scene_is_all_reachable():
    ground = ground_of(street(), CLEAR_M)
    assert ground.reachable.all()
    assert ground.nearest(1.0, 2.0) == (1.0, 2.0)
    assert not ground.is_free(50.0, 0.0)
    assert not ground.is_free(math.nan, 0.0)
    assert ground.region_at(50.0, 0.0) == 0


def test_free_ground_keeps_clearance_from_obstacles():
    scene = street(*STREET)
    ground = ground_of(scene, CLEAR_M)
    occupied = scene.occupancy.centres_m(*np.nonzero(scene.occupancy.cells > 0))
    free = scene.occupancy.centres_m(*np.nonzero(ground.reachable))
    to_rims = (np.maximum(abs(occupied - at) - RESOLUTION_M / 2, 0.0) for at in free[::97])
    gaps = [np.hypot(*rims.T).min() for rims in to_rims]
    assert CLEAR_M - 1e-9 <= min(gaps) < CLEAR_M + RESOLUTION_M
    assert not ground.is_free(8.0, 0.0)


def test_a_closed_house_is_free_and_not_reachable():
    ground = ground_of(street(walls=HOUSE), CLEAR_M)
    assert not ground.is_free(5.5, 0.0)
    assert ground.is_free(1.0, 0.0)
    x, y = ground.nearest(5.5, 0.0)
    assert ground.is_free(x, y)
    assert ground.nearest(5.5, 0.0, within_m=1.0) is None
    assert not ground.plan((0.0, 0.0), (5.5, 0.0)).ok


def test_a_robot_in_a_room_can_drive_only_in_that_room():
    ground = ground_of(street(walls=HOUSE, pose=SE2(5.5, 0.0, 0.0)), CLEAR_M)
    assert ground.is_free(5.0, 1.0)
    assert not ground.is_free(0.0, 0.0)


@pytest.mark.parametrize(("gap_m", "reachable"), [(ESCAPE_M - 0.2, True), (ESCAPE_M + 0.5, False)])
def test_a_robot_near_an_obstacle_starts_next_to_it(gap_m, reachable):
    """Closed ground all around, out to `gap_m`."""
    wall = (-gap_m, gap_m, -gap_m, gap_m)
    assert ground_of(street(walls=(wall,)), 0.0).reachable.any() == reachable


def test_unknown_ground_is_open_only_within_a_region():
    scene = street()
    scene.occupancy.cells[:, 120:] = -1
    scene.regions_grid.cells[100:, 120:] = 0
    ground = ground_of(scene, CLEAR_M)
    assert ground.is_free(10.0, -5.0)
    assert not ground.is_free(10.0, 5.0)


def test_the_robot_does_not_stop_on_unseen_ground():
    """The robot does not stop on unseen ground at a meadow that is no region."""
    scene = street(Thing("tree", 10.0, 0.0, (0.4, 0.4)))
    x_m, _ = np.moveaxis(scene.occupancy.centres_m(*np.indices(scene.occupancy.cells.shape)), -1, 0)
    scene.regions_grid.cells[x_m > 8.0] = 0
    scene.occupancy.cells[x_m > 9.0] = -1
    (x, _), _ = ground_of(scene, CLEAR_M).stopping_point(scene.objects[1], (0.0, 0.0))
    assert x <= 8.0


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.2, 0.3, 0.7]))
def test_script_and_refinement_close_the_same_ground(seed, clearance_m):
    rng = np.random.default_rng(seed)
    scene = street()
    scene.occupancy.cells[:] = rng.choice([-1, 0, 0, 0, 0, 100], scene.occupancy.cells.shape)
    scene.regions_grid.cells[:] = rng.choice([0, ROAD], scene.occupancy.cells.shape)
    grids = scene.occupancy, scene.regions_grid
    refines = value_map(*grids, {ROAD}, np.empty((0, 2)), PathMargins(clearance_m))
    writes = ground_of(scene, clearance_m).costmap
    np.testing.assert_array_equal(writes.weight > 0, refines.weight > 0)


def test_the_nearest_point_of_a_region_is_inside():
    ground = ground_of(street(), CLEAR_M)
    x, y = ground.nearest(0.0, 0.0, region=LAWN)
    assert ground.region_at(x, y) == LAWN
    assert math.hypot(x, y) == pytest.approx(10.0, abs=RESOLUTION_M)
    assert ground.nearest(0.0, 0.0, region=77) is None


def test_a_path_keeps_to_the_chosen_regions():
    """A wall across the road: round it over the lawn, unless the road has a gap further off."""
    ground = ground_of(street(walls=((5.0, 5.4, -8.0, 12.0),)), CLEAR_M)
    by_any, by_road = (
        ground.plan((0.0, 9.0), (10.0, 9.0), regions)
        for regions in (frozenset(), frozenset({ROAD}))
    )
    assert by_any.path_m[:, 1].max() > 12.0
    assert by_road.path_m[:, 1].min() < -8.0
    assert ground.plan((0.0, 9.0), (10.0, 9.0)).path_m.tolist() == by_any.path_m.tolist()
