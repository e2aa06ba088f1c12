"""The decoders' kernels agree with plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from edge.bus.wire import kernels


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize(("height", "width"), [(1, 0), (1, 1), (1, 500), (7, 31)])
def test_cloud_points(height, width, big_endian):
    rng = np.random.default_rng(width)
    points = rng.normal(size=(height, width, 3)).astype(np.float32)
    points[rng.random(points.shape) < 0.1] = np.nan
    points[rng.random(points.shape) < 0.1] = np.inf
    row_step, point_step, begin, offsets = 23 * width + 5, 23, 3, (9, 1, 17)
    data = rng.integers(0, 255, 64 + height * row_step, dtype=np.uint8)
    for axis, offset in enumerate(offsets):
        column = np.ndarray(
            (height, width), ">f4" if big_endian else "<f4", data, begin + offset,
            (row_step, point_step),
        )  # fmt: skip
        column[...] = points[..., axis]
    flat = points.reshape(-1, 3)
    expected = flat[np.isfinite(flat).all(axis=1)]
    out = np.zeros((height * width + 2, 3), np.float32)
    kept = kernels.cloud_points(
        data, begin, height, width, row_step, point_step, offsets, big_endian,
        out.view(np.uint32),
    )  # fmt: skip
    np.testing.assert_array_equal(out[:kept], expected)


@pytest.mark.parametrize("n", [0, 1, 720])
def test_scan_points(n):
    rng = np.random.default_rng(n)
    ranges = rng.uniform(-1, 12, n).astype(np.float32)
    ranges[rng.random(n) < 0.1] = np.nan
    angles = -3.0 + 0.01 * np.arange(n)
    hit = (ranges >= 0.2) & (ranges < 10.0)
    r, a = ranges[hit], angles[hit]
    expected = np.stack([r * np.cos(a), r * np.sin(a), np.zeros_like(r)], axis=1)
    out = np.zeros((max(n, 1), 3), np.float32)
    kept = kernels.scan_points(ranges, -3.0, 0.01, 0.2, 10.0, out)
    np.testing.assert_allclose(out[:kept], expected, atol=1e-5)
