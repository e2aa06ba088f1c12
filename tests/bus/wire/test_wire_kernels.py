"""The decoders' kernels agree with plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from edge.bus.wire import kernels


@pytest.mark.parametrize("n", [0, 1, 500])
def test_keep_finite(n):
    rng = np.random.default_rng(n)
    points = rng.normal(size=(n + 5, 3)).astype(np.float32)
    points[rng.random(points.shape) < 0.1] = np.nan
    points[rng.random(points.shape) < 0.1] = np.inf
    first = points[:n]
    expected = first[np.isfinite(first).all(axis=1)]
    kept = kernels.keep_finite(points, n)
    np.testing.assert_array_equal(points[:kept], expected)


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
