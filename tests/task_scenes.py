"""Small scenes with known truth: a street whose objects stand where a test says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge.geometry import SE2, CameraModel, Grid, se3, to_optical
from edge.tasks.scene.scene import Region, Scene, SceneObject

SIDE_M, RESOLUTION_M = 40.0, 0.2
ROAD, LAWN = 1, 2
START = SE2(0.0, 0.0, 0.0)
CAMERA = CameraModel.from_hfov(320, 200, 1.6)


@dataclass(frozen=True)
class Thing:
    """Box on the ground: label, middle, length, width, description and access point."""

    label: str
    x_m: float
    y_m: float
    size_m: tuple[float, float] = (2.0, 1.0)
    caption: str = ""
    nearest: bool = True


STREET = (
    Thing("van", 8.0, 0.0, (4.0, 2.0), "white van, ahead"),
    Thing("car", 4.0, 5.0, (3.0, 1.6), "red car"),
    Thing("car", 10.0, 6.0, (3.0, 1.6), "blue car"),
    Thing("car", 6.0, -5.0, (3.0, 1.6), "red car"),
    Thing("gate", 16.0, 2.0, (0.4, 3.0), "iron gate"),
)
"""By id, from 1: the robot stands at (0, 0) and looks along x."""


def street(
    *things: Thing,
    pose: SE2 = START,
    walls: tuple[tuple[float, float, float, float], ...] = (),
    picture: bool = False,
) -> Scene:
    """Return a scene of 40 m by 40 m around the origin, free but for its objects and walls."""
    n = round(SIDE_M / RESOLUTION_M)
    occupancy = Grid(np.zeros((n, n), np.int8), (-SIDE_M / 2, -SIDE_M / 2), RESOLUTION_M)
    centres_m = occupancy.centres_m(*np.indices((n, n)))
    x, y = centres_m[..., 0], centres_m[..., 1]
    boxes = [
        (t.x_m - t.size_m[0] / 2, t.x_m + t.size_m[0] / 2, t.y_m - t.size_m[1] / 2,
         t.y_m + t.size_m[1] / 2)
        for t in things
    ]  # fmt: skip
    for x0, x1, y0, y1 in (*boxes, *walls):
        occupancy.cells[(x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)] = 100
    ids = np.where(np.abs(y) < 10.0, ROAD, LAWN).astype(np.uint8)
    regions = {ROAD: Region(ROAD, "road", 800.0), LAWN: Region(LAWN, "lawn", 800.0)}
    rgb = np.full((CAMERA.height_px, CAMERA.width_px, 3), 90, np.uint8) if picture else None
    T_map_camera = to_optical(pose.matrix() @ se3(z_m=1.0))
    return Scene(
        stamp_ns=0,
        pose=pose,
        objects={k: _object(k, thing) for k, thing in enumerate(things, 1)},
        regions=regions,
        occupancy=occupancy,
        regions_grid=Grid(ids, occupancy.origin_xy_m, RESOLUTION_M),
        rgb=rgb,
        camera=CAMERA if picture else None,
        T_map_camera=T_map_camera if picture else None,
        contours=_contours(things, T_map_camera) if picture else {},
    )


def _object(number: int, thing: Thing) -> SceneObject:
    length, width = thing.size_m
    near = {ROAD: (thing.x_m - length / 2 - 1.0, thing.y_m)} if thing.nearest else {}
    return SceneObject(
        number, thing.label, thing.caption, np.array([thing.x_m, thing.y_m, 0.75]),
        np.array([length, width, 1.5]), 0.0, np.empty((0, 3), np.float32), near,
    )  # fmt: skip


def _contours(things: tuple[Thing, ...], T_map_camera: np.ndarray) -> dict[int, list[np.ndarray]]:
    """Return a square of 2 m around each object's middle, in pixels."""
    found = {}
    for k, thing in enumerate(things, 1):
        ray = T_map_camera[:3, :3].T @ ((thing.x_m, thing.y_m, 0.75) - T_map_camera[:3, 3])
        if ray[2] <= 0.1:
            continue
        u = CAMERA.cx_px + CAMERA.fx_px * ray[0] / ray[2]
        v = CAMERA.cy_px + CAMERA.fy_px * ray[1] / ray[2]
        half = CAMERA.fx_px / math.hypot(*ray)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        found[k] = [((u, v) + half * corners).astype(np.int32)]
    return found
