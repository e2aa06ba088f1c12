"""Ghosts: cells of the map that stay occupied in view after a person left them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from edge import config
from edge.geometry import CameraModel, Grid, se3, to_optical
from edge.lab.eval.ghosts import GhostClock
from edge.lab.sim.base import FloorPlan
from edge.mapping.grid import CLEAR_AFTER, RollingMap

CAMERA, HEIGHT_M, AWAY_M = CameraModel.from_hfov(160, 120, 1.3), 0.6, 1.5
T_CAMERA = to_optical(se3(z_m=HEIGHT_M))


def _image(person: bool) -> np.ndarray:
    """Return the depth of a floor, with a person in front or without."""
    down = (np.arange(CAMERA.height_px) - CAMERA.cy_px) / CAMERA.fy_px
    floor_m = np.where(down > 0.0, HEIGHT_M / np.maximum(down, 1e-6), np.inf)
    depth_m = np.tile(floor_m[:, None], (1, CAMERA.width_px)).astype(np.float32)
    if person:
        middle = np.abs(np.arange(CAMERA.width_px) - CAMERA.cx_px) < 0.1 * CAMERA.fx_px
        depth_m[:, middle] = np.minimum(depth_m[:, middle], AWAY_M)
    return depth_m


@pytest.mark.parametrize(
    ("comes", "images_late", "longest_s"), [(False, 3, 0.0), (True, 0, 0.0), (True, 3, 0.6)]
)
def test_a_ghost_lasts_until_the_map_is_free_again(comes, images_late, longest_s):
    plan = FloorPlan(Grid(np.zeros((200, 200), np.uint8), (-5.0, -5.0), 0.05))
    plan.clearance_m[:] = 5.0
    person = SimpleNamespace(xy_m=np.array([AWAY_M + 0.15, 0.0]))
    world = SimpleNamespace(people=[person] if comes else [], plan=plan, doors=[])
    clock, grid = GhostClock(world), RollingMap(config.MappingConfig(extent_m=12.0))

    def look(person: bool, update: bool = True) -> None:
        if update:
            grid.update_depth(_image(person), CAMERA, np.eye(4), T_CAMERA)
        clock.observe(grid, CAMERA, T_CAMERA, _image(person), 0.2)

    look(comes)
    assert grid.state_at(AWAY_M + 0.02, 0.0) == (100 if comes else 0)
    person.xy_m = np.array([-3.0, 0.0])
    for _ in range(images_late):
        look(False, update=False)
    assert clock.longest_s == pytest.approx(longest_s)
    for _ in range(CLEAR_AFTER + 5):
        look(False)
    assert clock.longest_s == pytest.approx(longest_s + 0.2 * (CLEAR_AFTER - 1) * comes)
