"""The rasteriser against a plain one that tests every ray with every triangle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.lab.sim import raster_kernels

CAMERA = CameraModel.from_hfov(32, 24, math.radians(75.0))


def rasterised(triangles: np.ndarray, T_map_camera: np.ndarray, faces_per_cluster: int = 4):
    """Return index of the face, weights of its corners and depth of each pixel."""
    count, shape = len(triangles), (CAMERA.height_px, CAMERA.width_px)
    first = np.append(np.arange(0, count, faces_per_cluster), count)
    boxes = np.empty((len(first) - 1, 6))
    raster_kernels.bound_clusters(triangles, first, boxes)
    face, depth = np.empty(shape, np.int32), np.empty(shape, np.float32)
    weights = np.empty((2, *shape), np.float32)
    raster_kernels.rasterise_view(
        triangles, first, boxes, np.linalg.inv(T_map_camera),
        CAMERA.fx_px, CAMERA.fy_px, CAMERA.cx_px, CAMERA.cy_px,
        np.empty(shape), face, weights, depth,
    )  # fmt: skip
    return face, weights, depth


def plain(triangles: np.ndarray, T_map_camera: np.ndarray):
    """Return the depth of each face along each pixel's ray, (h, w, n); inf for no hit."""
    T = np.linalg.inv(T_map_camera)
    corners = triangles.astype(float) @ T[:3, :3].T + T[:3, 3]  # (n, 3, 3)
    v, u = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px]
    x, y = (u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    b = np.einsum("hwj,nkj->hwnk", rays, np.linalg.inv(corners).transpose(0, 2, 1))
    with np.errstate(divide="ignore"):
        return np.where((b >= 0.0).all(axis=-1), 1.0 / b.sum(axis=-1), np.inf)


def test_nothing_is_seen_of_no_triangles():
    face, _, depth = rasterised(np.empty((0, 3, 3), np.float32), np.eye(4))
    assert (face == -1).all()
    assert np.isinf(depth).all()


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from((0.3, 1.0, 4.0)), st.integers(1, 5))
def test_rasterised_agrees_with_a_plain_ray_caster(seed, size_m, faces_per_cluster):
    """Triangles lie on all sides of the camera, some reach behind it."""
    rng = np.random.default_rng(seed)
    middles, corners = rng.uniform(-3, 3, (30, 1, 3)), rng.normal(0, size_m, (30, 3, 3))
    triangles = (middles + corners).astype(np.float32)
    T_map_camera = se3(*rng.uniform(-1, 1, 3), *rng.uniform(-3, 3, 3))
    face, weights, depth = rasterised(triangles, T_map_camera, faces_per_cluster)
    depths = plain(triangles, T_map_camera)
    nearest = depths.min(axis=-1)
    same = np.isclose(depth, nearest, rtol=1e-4) | (np.isinf(depth) & np.isinf(nearest))
    assert (~same).sum() <= 1, "but for a ray through a border"
    row, col = np.nonzero(same & (face >= 0))
    hit = face[row, col]
    second, third = weights[:, row, col].astype(float)
    points = np.einsum(
        "kn,nkj->nj", np.array([1.0 - second - third, second, third]), triangles[hit]
    )
    x, y = (col - CAMERA.cx_px) / CAMERA.fx_px, (row - CAMERA.cy_px) / CAMERA.fy_px
    z = depth[row, col]
    expected = np.stack([x * z, y * z, z, np.ones_like(z)], axis=1) @ T_map_camera.T
    np.testing.assert_allclose(points, expected[:, :3], atol=2e-3 * (1.0 + z.max(initial=0.0)))


def test_neighbouring_triangles_leave_no_gap():
    """Many slanted strips make up one surface: each pixel shows one of them."""
    y = np.linspace(-9, 9, 40)
    low, high = (np.stack([np.full(40, x), y, np.full(40, z)], 1) for x, z in ((1, -9), (7, 9)))
    quads = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.float32)
    face, _, _ = rasterised(triangles, to_optical(se3(0.0, 0.0, 0.0)), 16)
    assert (face >= 0).all()


def test_a_face_along_the_axes_of_the_image():
    """Its borders are rows and columns, but for rounding errors."""
    corners = [[-2.38149, 5.48027, 2.115804], [-2.38149, 3.294744, 0.583677],
               [-2.38149, 5.48027, 0.583677]]  # fmt: skip
    triangle = np.array([corners], np.float32)
    T_map_camera = SE2(3.8605, 4.5, math.pi).matrix() @ to_optical(se3(z_m=0.6))
    face, _, depth = rasterised(triangle, T_map_camera)
    nearest = plain(triangle, T_map_camera).min(axis=-1)
    assert (face >= 0).any()
    np.testing.assert_allclose(depth, nearest, rtol=1e-5)


@pytest.mark.parametrize("x_m", [-2.0, -0.5])
def test_a_triangle_behind_the_camera_is_not_drawn(x_m):
    triangle = np.array([[[x_m, -1, -1], [x_m, 1, -1], [x_m, 0, 1]]], np.float32)
    face, _, _ = rasterised(triangle, to_optical(se3()))
    assert (face == -1).all()
