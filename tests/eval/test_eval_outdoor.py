"""Outdoor episodes: the reference does what was said and collides with nothing."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np
import pytest

from edge.eval.outdoor import (
    BESIDE_M,
    CELL_M,
    KINDS,
    LEAST_POINTS,
    ROBOT_M,
    OutdoorEpisode,
    outdoor_episode,
    phrase,
)
from edge.eval.trajectory_metrics import contacts, likeness
from edge.motion.pursuit import MotionLimits
from edge.tasks.refine import refine
from edge.tasks.scene import SceneObject
from edge.tasks.value_map import Body

NUMBERS = range(16)
LIMITS = MotionLimits(1.5, 1.0, 0.8, 3.0)
episode = cache(outdoor_episode)


def meant(of: OutdoorEpisode) -> list[SceneObject]:
    """The things that an instruction names, in its order."""
    called = {phrase(of.scene, item): item for item in of.scene.objects.values()}
    at: dict[int, str] = {}
    for words in filter(None, called):
        if (place := of.instruction.find(words)) >= 0:
            # Of those that begin there, the longest.
            at[place] = max(at.get(place, ""), words, key=len)
    return [called[at[place]] for place in sorted(at)]


def gap_m(item: SceneObject, xy_m: np.ndarray) -> float:
    """From a point to a thing's outline on the ground, by points of it."""
    u = np.linspace(-0.5, 0.5, 41)
    local = np.stack(np.meshgrid(u * item.size_m[0], u * item.size_m[1]), axis=-1).reshape(-1, 2)
    c, s = math.cos(item.heading_rad), math.sin(item.heading_rad)
    outline = local @ np.array([[c, s], [-s, c]]) + item.position_m[:2]
    return float(np.hypot(*(outline - xy_m).T).min())


def test_a_number_is_an_episode():
    first, again = outdoor_episode(5), outdoor_episode(5)
    assert first.instruction == again.instruction
    np.testing.assert_array_equal(first.reference_m, again.reference_m)
    np.testing.assert_array_equal(first.cloud_m, again.cloud_m)
    np.testing.assert_array_equal(first.scene.occupancy.cells, again.scene.occupancy.cells)


def test_kinds_take_turns():
    assert [episode(k).kind for k in range(4)] == list(KINDS)


@pytest.mark.parametrize("number", NUMBERS)
def test_the_scene_is_whole(number):
    scene = episode(number).scene
    assert scene.rgb is None
    assert list(scene.objects) == list(range(1, len(scene.objects) + 1))
    assert set(np.unique(scene.regions_grid.cells)) <= {0, *scene.regions}
    assert set(np.unique(scene.occupancy.cells)) == {0, 100}
    for item in scene.objects.values():
        assert len(item.points_m) >= LEAST_POINTS
        assert item.points_m.dtype == np.float32
        # A tree's crown reaches farther than its trunk.
        reach = np.hypot(*(item.points_m[:, :2] - item.position_m[:2]).T).max()
        assert reach <= 0.5 * math.hypot(*item.size_m[:2]) + (1.8 if item.label == "tree" else 0.1)
        for region, point in item.nearest_m.items():
            assert scene.regions_grid.cells[scene.regions_grid.cell_of(*point)] == region


@pytest.mark.parametrize("number", NUMBERS)
def test_the_scan_is_a_lidars(number):
    cloud_m = episode(number).cloud_m
    assert cloud_m.dtype == np.float32
    assert 40_000 < len(cloud_m) <= 64 * 1024
    elevation = np.arctan2(cloud_m[:, 2] - 1.73, np.hypot(*cloud_m[:, :2].T))
    assert len(np.unique(np.round(np.degrees(elevation) / (26.8 / 63), 2))) <= 64 * 3
    assert cloud_m[:, 2].min() > -0.01


@pytest.mark.parametrize("number", NUMBERS)
def test_who_is_named_is_named_alone(number):
    scene = episode(number).scene
    phrases = [words for item in scene.objects.values() if (words := phrase(scene, item))]
    assert len(phrases) == len(set(phrases)) > 3


@pytest.mark.parametrize("number", NUMBERS)
def test_the_reference_leads_where_it_says(number):
    this = episode(number)
    things = meant(this)
    assert len(things) == (1 if this.kind == "to" else 2)
    assert this.reference_m[0].tolist() == [0.0, 0.0]
    assert gap_m(things[-1], this.reference_m[-1]) < 3.5
    assert contacts(this.reference_m, this.scene.occupancy, ROBOT_M - CELL_M) == 0
    rows = np.floor(this.scene.regions_grid.of_metres(this.reference_m)).astype(int)
    assert (this.scene.regions_grid.cells[rows[:, 1], rows[:, 0]] > 0).all()
    for segment in this.segments:
        for point in segment:
            assert np.hypot(*(this.reference_m - point).T).min() < CELL_M


@pytest.mark.parametrize("number", [n for n in NUMBERS if n % 4 in (1, 2)])
def test_it_passes_on_the_side_that_was_said(number):
    this = episode(number)
    first = meant(this)[0]
    (side,) = re.findall("the (left|right) of", this.instruction)
    toward = first.position_m[:2]
    aside = [toward[0] * (p - toward)[1] - toward[1] * (p - toward)[0] for p in this.segments[0]]
    if this.kind == "around":
        # Its last point lies behind the thing.
        assert float(np.dot(this.segments[0][-1] - toward, toward)) > 0.0
        aside = aside[:-1]
    assert all(value > 0.0 for value in aside) == (side == "left")
    assert all(value < 0.0 for value in aside) == (side == "right")
    for point in this.segments[0]:
        assert BESIDE_M - 0.1 < gap_m(first, point) < BESIDE_M + 1.5


@pytest.mark.parametrize("number", NUMBERS)
def test_what_the_rule_leads_by_can_be_refined(number):
    this = episode(number)
    got = refine(this.scene, this.segments, this.regions, Body(ROBOT_M, 1.0), LIMITS)
    like = likeness(got.poses[:, :2], this.reference_m, this.scene.occupancy, ROBOT_M - CELL_M)
    assert (like.success, like.contacts) == (True, 0)
    assert got.off_region_m == 0.0


@pytest.mark.slow
def test_there_are_two_hundred():
    names = {outdoor_episode(number).name for number in range(200)}
    assert len(names) == 200
