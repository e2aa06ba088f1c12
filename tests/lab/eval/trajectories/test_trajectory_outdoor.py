"""Outdoor episodes: the reference follows the instruction without a collision."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.trajectories.outdoor import (
    MIN_POINTS,
    ROBOT_M,
    outdoor_episode,
    outdoor_scene,
)
from edge.lab.eval.trajectory_metrics import contacts, navigation_error_m
from edge.lab.sim.street import street
from edge.tasks.refine import refine
from edge.tasks.scene.value_map import PathMargins
from edge.trajectory.pursuit import MotionLimits

NUMBERS = range(16)
LIMITS = MotionLimits(1.5, 1.0, 0.8, 3.0)
episode = cache(outdoor_episode)


def test_a_number_is_an_episode():
    first, again = outdoor_episode(5), outdoor_episode(5)
    assert first.task.instruction == again.task.instruction
    np.testing.assert_array_equal(first.task.reference_m, again.task.reference_m)
    np.testing.assert_array_equal(first.scene.occupancy.cells, again.scene.occupancy.cells)


@pytest.mark.parametrize("number", NUMBERS)
def test_the_scene_is_whole(number):
    scene = episode(number).scene
    assert scene.rgb is None
    assert list(scene.objects) == list(range(1, len(scene.objects) + 1))
    assert set(np.unique(scene.regions_grid.cells)) <= {0, *scene.regions}
    assert set(np.unique(scene.occupancy.cells)) == {0, 100}
    for item in scene.objects.values():
        assert len(item.points_m) >= MIN_POINTS
        assert item.points_m.dtype == np.float32
        # A tree's crown reaches farther than its trunk.
        reach = np.hypot(*(item.points_m[:, :2] - item.position_m[:2]).T).max()
        assert reach <= 0.5 * math.hypot(*item.size_m[:2]) + (1.8 if item.label == "tree" else 0.1)
        for region, point in item.nearest_m.items():
            assert scene.regions_grid.cells[scene.regions_grid.cell_of(*point)] == region


@pytest.mark.parametrize("number", NUMBERS)
def test_the_scan_is_a_lidars(number):
    _, cloud_m = outdoor_scene(street(number))
    assert cloud_m.dtype == np.float32
    assert 40_000 < len(cloud_m) <= 64 * 1024
    elevation = np.arctan2(cloud_m[:, 2] - 1.73, np.hypot(*cloud_m[:, :2].T))
    assert len(np.unique(np.round(np.degrees(elevation) / (26.8 / 63), 2))) <= 64 * 3
    assert cloud_m[:, 2].min() > -0.01


@pytest.mark.parametrize("number", NUMBERS)
def test_task_segments_can_be_refined_without_contacts(number):
    this = episode(number)
    got = refine(this.scene, this.task.segments, (), PathMargins(ROBOT_M, 1.0), LIMITS)
    path_m = got.poses[:, :2]
    assert navigation_error_m(path_m, this.task.reference_m) <= REACHED_M
    assert contacts(path_m, this.scene.occupancy, ROBOT_M) == 0
    assert not any("not chosen" in note for note in got.notes)


@pytest.mark.slow
def test_there_are_two_hundred():
    assert all(outdoor_episode(number).task.instruction for number in range(200))
