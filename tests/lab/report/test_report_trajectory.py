"""A trajectory from above and in the camera's picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from task_scenes import STREET, street

from edge.config import load
from edge.lab.report import trajectory_map
from edge.lab.report.camera_picture import REFINED_RGB, draw_trajectory
from edge.tasks.refine import refine
from edge.tasks.scene.value_map import PathMargins, value_map
from edge.trajectory.pursuit import MotionLimits

AHEAD_M = np.column_stack([np.linspace(0.0, 6.0, 60), np.zeros(60), np.zeros(60)])


def test_without_a_camera_nothing_is_drawn():
    assert draw_trajectory(street(), None, AHEAD_M, 0.3) is None


@pytest.mark.parametrize("poses_m", [None, AHEAD_M[:0], AHEAD_M - (9.0, 0.0, 0.0)])
def test_poses_outside_the_camera_view_are_not_drawn(poses_m):
    """The ground at the camera's feet is an exception: a path from behind may end there."""
    scene = street(picture=True)
    image = draw_trajectory(scene, None, poses_m, 0.3)
    assert image.shape == (800, 1280, 3)
    assert (image == 90).all()


def test_the_strip_is_faint_behind_an_object():
    from dataclasses import replace

    open_way = street(picture=True)
    van = street(*STREET[:1], picture=True)
    points = np.array([[2.0, 0.0, 0.5]], np.float32)
    obj = replace(van.objects[1], points_m=points)
    outline = [np.array([[0, 0], [319, 0], [319, 199], [0, 199]], np.int32)]
    before = replace(open_way, objects={1: obj}, contours={1: outline})
    strong, faint = (
        draw_trajectory(scene, None, AHEAD_M[20:], 0.5) for scene in (open_way, before)
    )
    assert faint[..., 0].sum() < strong[..., 0].sum()
    assert not (faint == REFINED_RGB).all(axis=2).all()


def png(scene, *args):
    content = np.frombuffer(trajectory_map.png(scene, *args), np.uint8)
    return cv2.cvtColor(cv2.imdecode(content, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def test_a_scene_without_a_trajectory_is_one_panel():
    alone = png(street(*STREET), None, None, None)
    assert alone.shape[1] == pytest.approx(1008, abs=40)
    limits = MotionLimits.of(load("street").robot)
    scene, body = street(*STREET), PathMargins(0.3)
    coarse_m = np.array([[0.0, 0.0], [4.0, -2.5], [14.0, -2.5]])
    refined = refine(scene, [coarse_m], [1], body, limits)
    costmap = value_map(scene.occupancy, scene.regions_grid, refined.drivable, coarse_m, body)
    both = png(scene, coarse_m, refined, costmap)
    red = np.abs(both.astype(int) - (214, 34, 91)).max(axis=2) < 12
    assert red.sum() > 200
    assert green(both).sum() > 2000  # the tube of the value map


def green(image):
    return np.abs(image.astype(int) - (0x8C, 0xE9, 0x9A)).max(axis=2) < 3
