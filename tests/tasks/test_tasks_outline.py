"""Part of an object that blocks the way."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_scenes import Thing, street

from edge.tasks.scene.outline import outline_of

SOFA = Thing("sofa", 8.0, 2.0, (3.2, 3.2))


def outline(obj, *free):
    """Return the outline of an object in a street with free parts (x0, x1, y0, y1) of its box."""
    scene = street(obj)
    x, y = np.moveaxis(scene.occupancy.centres_m(*np.indices(scene.occupancy.cells.shape)), -1, 0)
    for x0, x1, y0, y1 in free:
        scene.occupancy.cells[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = 0
    return outline_of(scene.objects[1], scene.occupancy)


def test_without_occupied_cells_the_outline_is_the_box():
    got = outline(SOFA, (0.0, 20.0, -9.0, 9.0))
    assert got.gaps_m(np.array([[8.0, 4.6]])) == pytest.approx([1.0], abs=0.02)
    assert got.point_at(0.0, 1.0) == pytest.approx((10.6, 2.0), abs=1e-3)


def test_a_distance_is_measured_from_the_rim():
    got = outline(SOFA)
    assert got.point_at(math.pi / 2, 1.0) == pytest.approx((8.0, 4.6), abs=1e-3)
    corner = 1.6 + math.sqrt(0.5)
    assert got.point_at(math.pi / 4, 1.0) == pytest.approx((8.0 + corner, 2.0 + corner), abs=1e-3)
    assert got.gaps_m(np.array([[8.0, 2.0], [8.0, 5.5]])) == pytest.approx([0.0, 1.9], abs=0.05)


def test_the_pocket_of_a_corner_sofa_is_not_passable():
    got = outline(SOFA, (6.0, 8.8, 0.0, 2.8))
    assert got.gaps_m(np.array([[7.0, 1.0]]))[0] > 1.5
    x, y = got.point_at(math.radians(225), 0.5)
    hull = (got.hull_m + got.middle_m).astype(np.float32)
    assert cv2.pointPolygonTest(hull, (x, y), True) == pytest.approx(-0.5, abs=1e-3)


def test_unseen_parts_of_an_object_belong_to_its_outline():
    scene = street(Thing("car", 8.0, 0.0, (4.0, 2.0)))
    hidden = scene.occupancy.centres_m(*np.indices(scene.occupancy.cells.shape))[..., 1] > -0.7
    scene.occupancy.cells[(scene.occupancy.cells > 0) & hidden] = -1
    got = outline_of(scene.objects[1], scene.occupancy)
    assert got.point_at(math.pi / 2, 0.0) == pytest.approx((8.0, 1.0), abs=0.21)


def test_distances_are_measured_to_the_seen_surface():
    scene = street(Thing("building", 8.0, 0.0, (8.0, 6.0)))
    front = np.column_stack((np.full(30, 4.05), np.linspace(-3.0, 3.0, 30), np.ones(30)))
    seen = replace(scene.objects[1], points_m=front.astype(np.float32))
    got = outline_of(seen, scene.occupancy)
    assert got.gaps_m(np.array([[3.0, 0.0], [13.0, 0.0]])) == pytest.approx([1.0, 8.9], abs=0.1)
    assert got.point_at(0.0, 1.0) == pytest.approx((13.0, 0.0), abs=0.01), "it is passed behind"


def test_the_robot_goes_to_the_trunk_of_a_tree():
    """A trunk of 0.4 m under a crown of 4 m; below the crown the map is free."""
    scene = street(Thing("tree", 8.0, 0.0, (0.4, 0.4)))
    trunk_m = np.array([(7.9, 0.0, z) for z in np.arange(0.2, 2.5, 0.1)])
    crown_m = np.array([(8.0 + dx, dy, 2.0) for dx in (-2.0, 2.0) for dy in (-2.0, 0.0, 2.0)])
    points_m = np.concatenate((trunk_m, crown_m)).astype(np.float32)
    tree = replace(scene.objects[1], points_m=points_m)
    at_m = np.array([[5.0, 0.0]])
    assert outline_of(tree, scene.occupancy).gaps_m(at_m) == pytest.approx([2.8], abs=0.2)
    low = replace(tree, points_m=np.concatenate((points_m, [(6.5, 0.0, 0.5)])).astype(np.float32))
    assert outline_of(low, scene.occupancy).gaps_m(at_m) == pytest.approx([1.4], abs=0.2)
    all_over = replace(tree, points_m=points_m[len(trunk_m) :])
    assert outline_of(all_over, scene.occupancy).gaps_m(at_m) == pytest.approx([1.0], abs=0.2)


@given(st.integers(0, 99), st.floats(-30.0, 30.0))
def test_distances_of_all_cells_are_those_of_their_centres(seed, x_m):
    scene = street(SOFA)
    points_m = np.random.default_rng(seed).uniform(-3.0, 3.0, (40, 3)).astype(np.float32) + x_m
    got = outline_of(replace(scene.objects[1], points_m=points_m), scene.occupancy)
    by_cell_m = got.gaps_by_cell_m(scene.occupancy)
    rows, columns = np.indices(by_cell_m.shape)[:, ::9, ::7]
    wanted_m = got.gaps_m(scene.occupancy.centres_m(rows, columns).reshape(-1, 2))
    assert by_cell_m[rows, columns].ravel() == pytest.approx(wanted_m, abs=1e-4)


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 8.0), st.booleans())
def test_point_at_keeps_its_distance_from_the_hull(angle_rad, distance_m, corner):
    got = outline(SOFA, *([(6.0, 8.8, 0.0, 2.8)] if corner else []))
    at = got.point_at(angle_rad, distance_m)
    hull = (got.hull_m + got.middle_m).astype(np.float32)
    away_m = -cv2.pointPolygonTest(hull, at, True)
    assert away_m == pytest.approx(distance_m, abs=2e-3) or away_m > distance_m
    assert got.gaps_m(np.array([at]))[0] >= distance_m - 0.05
