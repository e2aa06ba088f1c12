"""The ray caster against a plain one that tries every ray on every solid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.config import Lidar
from edge.geometry import CameraModel, se3, to_optical
from edge.lab.sim import kernels, shading
from edge.lab.sim.base import LidarRays

CAMERA = CameraModel.from_hfov(72, 56, math.radians(80.0))
LENS = (CAMERA.fx_px, CAMERA.fy_px, CAMERA.cx_px, CAMERA.cy_px)


def random_scene(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Solids of all shapes around the origin, some behind, some very near."""
    shape = rng.integers(0, 3, count).astype(np.uint8)
    pose = np.empty((count, 8))
    pose[:, :3] = rng.uniform(-4.0, 4.0, (count, 3))
    pose[:, 3:6] = rng.uniform(0.05, 1.2, (count, 3))
    yaw = rng.uniform(-math.pi, math.pi, count)
    pose[:, 6], pose[:, 7] = np.cos(yaw), np.sin(yaw)
    return shape, pose


def plain_cast(shape, pose, origin, directions):
    """(rays, solids) distances along `directions` (n, 3); inf where a ray misses."""
    out = np.full((len(directions), len(shape)), np.inf)
    for i in range(len(shape)):
        c, s = pose[i, 6], pose[i, 7]
        R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        # Unit solid: |x| <= 1 on every axis, or x.x <= 1.
        o, d = R @ (origin - pose[i, :3]) / pose[i, 3:6], directions @ R.T / pose[i, 3:6]
        t_in, t_out = np.full(len(d), -np.inf), np.full(len(d), np.inf)
        flat = {kernels.BOX: (0, 1, 2), kernels.CYLINDER: (2,), kernels.ELLIPSOID: ()}[shape[i]]
        with np.errstate(divide="ignore", invalid="ignore"):
            for axis in flat:
                a, b = (-1.0 - o[axis]) / d[:, axis], (1.0 - o[axis]) / d[:, axis]
                t_in, t_out = (
                    np.maximum(t_in, np.minimum(a, b)),
                    np.minimum(t_out, np.maximum(a, b)),
                )
            if shape[i] != kernels.BOX:
                n = 2 if shape[i] == kernels.CYLINDER else 3
                A, B = (d[:, :n] ** 2).sum(1), d[:, :n] @ o[:n]
                root = np.sqrt(B * B - A * (o[:n] @ o[:n] - 1.0))
                root = np.where(np.isnan(root), -np.inf, root)
                t_in, t_out = np.maximum(t_in, (-B - root) / A), np.minimum(t_out, (-B + root) / A)
        hit = (t_in <= t_out) & (t_in > kernels.NEAR_M)
        out[hit, i] = t_in[hit]
    return out


def random_pose(rng: np.random.Generator) -> np.ndarray:
    x, y, z = rng.uniform(-1.0, 1.0, 3)
    return se3(x, y, z, rng.uniform(-0.2, 0.2), rng.uniform(-0.6, 0.6), rng.uniform(-3, 3))


def render_depth(shape, pose, T):
    depth = np.empty((CAMERA.height_px, CAMERA.width_px), np.float32)
    prim = np.empty(depth.shape, np.int32)
    kernels.render_depth(shape, pose, T, *LENS, depth, prim)
    return depth, prim


def test_an_empty_scene_gives_no_depth():
    depth, prim = render_depth(np.empty(0, np.uint8), np.empty((0, 8)), np.eye(4))
    assert np.isinf(depth).all()
    assert (prim == -1).all()


@pytest.mark.parametrize("seed", range(12))
def test_render_depth_agrees_with_the_plain_caster(seed: int):
    rng = np.random.default_rng(seed)
    shape, pose = random_scene(rng, 30)
    T = random_pose(rng) @ to_optical(np.eye(4))
    depth, prim = render_depth(shape, pose, T)
    u, v = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    rays = np.stack([(u - LENS[2]) / LENS[0], (v - LENS[3]) / LENS[1], np.ones(u.shape)], axis=-1)
    expected = plain_cast(shape, pose, T[:3, 3], rays.reshape(-1, 3) @ T[:3, :3].T)
    nearest = expected.min(axis=1).reshape(depth.shape)
    assert np.isfinite(nearest).mean() > 0.05
    np.testing.assert_allclose(depth, nearest, rtol=1e-5)
    hit = prim >= 0
    np.testing.assert_array_equal(hit, np.isfinite(nearest))
    chosen = np.take_along_axis(expected, prim.reshape(-1, 1).clip(0), axis=1).reshape(depth.shape)
    np.testing.assert_allclose(chosen[hit], nearest[hit], rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_name_hits_agrees_with_a_plain_one(seed: int):
    rng = np.random.default_rng(seed)
    owner = rng.integers(0, 60000, 25).astype(np.uint16)
    hit = rng.integers(-1, 25, (12, 17)).astype(np.int32)
    depth = rng.uniform(0.0, 9.0, hit.shape).astype(np.float32)
    depth[rng.random(hit.shape) < 0.2] = np.inf
    before, ids = depth.copy(), np.empty(hit.shape, np.uint16)
    kernels.write_object_ids(hit, owner, 0.5, 6.0, depth, ids)
    np.testing.assert_array_equal(ids, np.where(hit < 0, 0, owner[hit]))
    given = (before >= np.float32(0.5)) & (before <= np.float32(6.0))
    np.testing.assert_array_equal(depth, np.where(given, before, np.nan))


@pytest.mark.parametrize("pitch_deg", [0.0, 23.0, -40.0])
@pytest.mark.parametrize("rings", [1, 9])
@pytest.mark.parametrize("seed", range(3))
def test_cast_fan_agrees_with_the_plain_caster(rings: int, pitch_deg: float, seed: int):
    rng = np.random.default_rng(seed)
    shape, pose = random_scene(rng, 25)
    fan = LidarRays.of(Lidar(rings=rings, columns=60, vfov_deg=80.0))
    T = random_pose(rng) @ se3(pitch_rad=math.radians(pitch_deg))
    ranges = np.empty(fan.directions.shape[:2], np.float32)
    kernels.cast_fan(shape, pose, T, fan.directions, fan.el_min_rad, fan.el_step_rad, ranges)
    rays = fan.directions.reshape(-1, 3) @ T[:3, :3].T
    expected = plain_cast(shape, pose, T[:3, 3], rays).min(axis=1).reshape(ranges.shape)
    np.testing.assert_allclose(ranges, expected, rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_rasterise_agrees_with_a_check_of_every_cell(seed: int):
    shape, pose = random_scene(np.random.default_rng(seed), 12)
    grid, cell, origin = np.zeros((180, 200), np.uint8), 0.05, np.array([-5.0, -4.5])
    kernels.rasterise(shape, pose, 0.05, 0.8, origin, cell, grid)
    x = origin[0] + (np.arange(200) + 0.5) * cell
    y = origin[1] + (np.arange(180)[:, None] + 0.5) * cell
    expected = np.zeros(grid.shape, bool)
    for i in range(len(shape)):
        if pose[i, 2] - pose[i, 5] >= 0.8 or pose[i, 2] + pose[i, 5] <= 0.05:
            continue
        dx, dy, c, s = x - pose[i, 0], y - pose[i, 1], pose[i, 6], pose[i, 7]
        a = np.abs(c * dx + s * dy) / (pose[i, 3] + cell / 2)
        b = np.abs(c * dy - s * dx) / (pose[i, 4] + cell / 2)
        expected |= np.maximum(a, b) <= 1.0 if shape[i] == kernels.BOX else a * a + b * b <= 1.0
    np.testing.assert_array_equal(grid.astype(bool), expected)


def shade_one(shape: int, texture: int, color: tuple[float, float, float]):
    """Shade a big solid 2 m ahead that fills part of the image; return rgb, prim."""
    shapes = np.array([shape], np.uint8)
    pose = np.array([[2.5, 0.0, 0.0, 0.5, 0.8, 0.6, 1.0, 0.0]])
    T = to_optical(np.eye(4))
    depth, prim = render_depth(shapes, pose, T)
    rgb = np.empty((*depth.shape, 3), np.uint8)
    shading.shade(
        shapes, pose, np.array([color], np.float32), np.array([texture], np.uint8), T, *LENS,
        depth, prim, np.ones((4, 4), np.float32), np.zeros(2), 0.05,
        np.array([1, 2, 3], np.uint8), rgb,
    )  # fmt: skip
    return rgb, prim


@pytest.mark.parametrize("shape", [kernels.BOX, kernels.CYLINDER, kernels.ELLIPSOID])
@pytest.mark.parametrize("texture", range(10))
def test_shade_colours_hits_and_paints_the_rest_as_sky(shape: int, texture: int):
    rgb, prim = shade_one(shape, texture, (200.0, 60.0, 60.0))
    hit = prim == 0
    assert 0.05 < hit.mean() < 0.95
    assert (rgb[~hit] == (1, 2, 3)).all()
    mean = rgb[hit].mean(axis=0)
    assert mean[0] > 1.2 * max(mean[1], mean[2])


def test_light_depends_on_the_normal_and_the_height():
    rgb, prim = shade_one(kernels.BOX, shading.PLAIN, (200.0, 100.0, 50.0))
    red = rgb[prim == 0][:, 0]
    # The front's normal is -x: light 0.80 - 0.20 * 0.30; full above 0.35 m, 0.84 of it at 0.
    assert red.max() == pytest.approx(200.0 * 0.74, abs=1.0)
    assert red.min() == pytest.approx(200.0 * 0.74 * 0.84, abs=1.0)


def plain_shade(shape, pose, color, depth, prim, T, clearance_m, origin_m, cell_m):
    """(h, w, 3) float colours of untextured solids; NaN where nothing was hit."""
    out = np.full((*depth.shape, 3), np.nan)
    for v, u in zip(*np.nonzero(prim >= 0), strict=True):
        i = prim[v, u]
        x, y, z, hx, hy, hz, c, s = pose[i]
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        ray = np.array([(u - LENS[2]) / LENS[0], (v - LENS[3]) / LENS[1], 1.0])
        point = T[:3, :3] @ ray * float(depth[v, u]) + T[:3, 3]
        p = R.T @ (point - (x, y, z))
        q = p / (hx, hy, hz)
        if shape[i] == kernels.ELLIPSOID:
            normal = q / (hx, hy, hz)
        elif shape[i] == kernels.CYLINDER and abs(q[2]) <= np.hypot(q[0], q[1]):
            normal = np.array([q[0] / hx, q[1] / hy, 0.0])
        else:
            axis = 2 if shape[i] == kernels.CYLINDER else int(np.argmax(np.abs(q)))
            normal = np.eye(3)[axis] * np.sign(q[axis])
        normal = normal / np.linalg.norm(normal)
        light = 0.8 + 0.2 * (R @ normal) @ (0.30, 0.42, 0.86)
        flat = shape[i] != kernels.ELLIPSOID and abs(normal[2]) == 1.0
        if not flat:
            light *= 0.84 + 0.16 * np.clip(point[2] / 0.35, 0.0, 1.0)
        elif point[2] < 0.02:
            col, row = ((point[:2] - origin_m) / cell_m).astype(int)
            if 0 <= row < clearance_m.shape[0] and 0 <= col < clearance_m.shape[1]:
                light *= 0.66 + 0.34 * min(1.0, clearance_m[row, col] / 0.3)
        out[v, u] = np.minimum(255.0, color[i] * light)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_shade_agrees_with_a_plain_one_on_untextured_solids(seed: int):
    rng = np.random.default_rng(seed)
    shape, pose = random_scene(rng, 25)
    color = rng.uniform(0.0, 255.0, (25, 3)).astype(np.float32)
    clearance = rng.uniform(0.0, 0.5, (80, 80)).astype(np.float32)
    floor = (clearance, np.array([-4.0, -4.0]), 0.1)
    T = random_pose(rng) @ to_optical(np.eye(4))
    depth, prim = render_depth(shape, pose, T)
    rgb = np.empty((*depth.shape, 3), np.uint8)
    shading.shade(
        shape, pose, color, np.full(25, shading.PLAIN, np.uint8), T, *LENS, depth, prim,
        *floor, np.zeros(3, np.uint8), rgb,
    )  # fmt: skip
    expected = plain_shade(shape, pose, color, depth, prim, T, *floor)
    hit = prim >= 0
    wrong = np.abs(rgb[hit] - expected[hit]).max(axis=1) > 1.01
    # On an edge, rounding may choose the other face, or the other cell of the floor.
    assert wrong.mean() < 0.005
