"""Benchmark: points of a scan in each mask (OpenNav eq. 2)."""

from __future__ import annotations

import numpy as np
import pytest

from edge.geometry import CameraModel
from edge.tasks.scene.projection import GAP_M, GAP_SHARE, MARGIN_SHARE, in_picture, points_of_masks
from edge.types import MASK_SIDE

CAMERA = CameraModel(1226, 370, 707.0, 707.0, 601.9, 183.1)
POINTS, MASKS = 120_000, 20
T_CAMERA_CLOUD = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])


@pytest.fixture(scope="module")
def scan():
    """Return a scan of 64 rings, with objects at every distance and boxes with round masks."""
    random = np.random.default_rng(0)
    elevation = np.radians(random.choice(np.linspace(2.0, -24.8, 64), POINTS))
    azimuth = random.uniform(-np.pi, np.pi, POINTS)
    range_m = random.choice([6.0, 12.0, 20.0, 35.0], POINTS) + random.uniform(0.0, 1.5, POINTS)
    flat = range_m * np.cos(elevation)
    cloud = np.stack(
        (flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation)), axis=1
    ).astype(np.float32)
    corner = random.uniform((0, 120), (1000, 220), (MASKS, 2))
    boxes = np.hstack((corner, corner + random.uniform(40, 200, (MASKS, 2)))).astype(np.float32)
    across = np.linspace(-1, 1, MASK_SIDE)
    masks = np.repeat((across**2 + across[:, None] ** 2 < 1.0)[None], MASKS, axis=0)
    return cloud, boxes, masks


def points_by_numpy(cloud, boxes, masks):
    """Return the points of each mask: the reference for `points_of_masks`, in NumPy.

    For each mask, take the points in a widened box, split them by depth at gaps, and keep the
    cluster that fits the mask best.
    """
    at_px, shown = in_picture(cloud, T_CAMERA_CLOUD, CAMERA)
    seen = np.flatnonzero(shown)
    u, v = at_px[seen].T
    depth = (cloud[seen] @ T_CAMERA_CLOUD[2, :3] + T_CAMERA_CLOUD[2, 3]).astype(np.float32)
    out = []
    for (x0, y0, x1, y1), mask in zip(boxes, masks, strict=True):
        margin_u, margin_v = MARGIN_SHARE * (x1 - x0), MARGIN_SHARE * (y1 - y0)
        near = (u >= x0 - margin_u) & (u < x1 + margin_u)
        near &= (v >= y0 - margin_v) & (v < y1 + margin_v)
        at = np.flatnonzero(near)
        r = ((v[at] - y0) / (y1 - y0) * MASK_SIDE).astype(np.intp)
        c = ((u[at] - x0) / (x1 - x0) * MASK_SIDE).astype(np.intp)
        inside = (r >= 0) & (r < MASK_SIDE) & (c >= 0) & (c < MASK_SIDE)
        inside &= (v[at] >= y0) & (u[at] >= x0)
        in_mask = np.zeros(len(at), np.bool_)
        in_mask[inside] = mask[r[inside], c[inside]]
        # A gap between neighbours in depth begins a new cluster; it may grow with the depth.
        order = np.argsort(depth[at])
        at, in_mask = at[order], in_mask[order]
        d = depth[at]
        cluster = np.concatenate(([0], np.cumsum(np.diff(d) > GAP_M + GAP_SHARE * d[:-1])))
        n_in_mask = np.bincount(cluster, in_mask)
        iou = n_in_mask / np.maximum(in_mask.sum() + np.bincount(cluster, ~in_mask), 1)
        out.append(np.sort(seen[at[in_mask & (cluster == np.argmax(iou))]]))
    return out


def test_points_of_masks(benchmark, scan, against):
    """Check the result against the reference, then measure both."""
    benchmark.extra_info["budget"] = "project_120k_20_masks"
    cloud, boxes, masks = scan
    expected = points_by_numpy(*scan)
    got = points_of_masks(cloud, T_CAMERA_CLOUD, CAMERA, boxes, masks)
    assert sum(len(points) for points in got) > 1000
    for got_points, expected_points in zip(got, expected, strict=True):
        # At the edge of a mask's cell, float32 and float64 may differ.
        n_different = len(np.setxor1d(got_points, expected_points))
        assert n_different <= 0.01 * len(expected_points) + 1
    benchmark(points_of_masks, cloud, T_CAMERA_CLOUD, CAMERA, boxes, masks)
    against(lambda: points_by_numpy(*scan))
