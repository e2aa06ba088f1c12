"""The decoders' kernels agree with plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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


@pytest.mark.parametrize("free_m", [0.0, 10.0])
@pytest.mark.parametrize("n", [0, 1, 720])
def test_scan_points(n, free_m):
    rng = np.random.default_rng(n)
    ranges = rng.uniform(-1, 12, n).astype(np.float32)
    for odd in (np.nan, np.inf, -np.inf, 10.0):
        ranges[rng.random(n) < 0.1] = odd
    angles = -3.0 + 0.01 * np.arange(n)
    past = (ranges >= 10.0) & (free_m > 0.0)
    kept = ((ranges >= 0.2) & (ranges < 10.0)) | past
    r, z = np.where(past, free_m, ranges)[kept], np.where(past, np.inf, 0.0)[kept]
    expected = np.stack([r * np.cos(angles[kept]), r * np.sin(angles[kept]), z], axis=1)
    out = np.zeros((max(n, 1), 3), np.float32)
    rows = kernels.scan_points(ranges, -3.0, 0.01, 0.2, 10.0, free_m, out)
    np.testing.assert_allclose(out[:rows], expected, atol=1e-5)


@given(
    shape=st.tuples(st.integers(0, 5), st.integers(0, 9)),
    big_endian=st.booleans(),
    begin=st.integers(0, 5),
    padding=st.integers(0, 3),
    unit_m=st.sampled_from([0.001, 0.0002, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_depth_of_integers(shape, big_endian, begin, padding, unit_m, seed):
    rng, (h, w) = np.random.default_rng(seed), shape
    row_step, code = 2 * w + padding, ">u2" if big_endian else "<u2"
    data = rng.integers(0, 256, begin + h * row_step, dtype=np.uint8)
    steps = np.ndarray(shape, code, data, begin, (row_step, 2))
    steps[rng.random(shape) < 0.3] = rng.choice([0, 63_999, 64_000, 65_535])
    data.flags.writeable = False
    out, unit = np.full(shape, 9.0, np.float32), np.float32(unit_m)
    kernels.depth_of_integers(data, begin, row_step, big_endian, unit, np.uint16(64_000), out)
    expected = np.where(steps < 64_000, steps.astype(np.float32) * unit, 0)
    np.testing.assert_array_equal(out, expected)


def plain_millimetres(depth_m):
    with np.errstate(invalid="ignore"):
        mm = np.rint(depth_m.astype(np.float64) * 1000.0)
        fits = (mm >= 0) & (mm <= 65535)
        mm = np.where(fits, mm, 0).astype(np.uint16)
    return bool(np.array_equal(mm * np.float32(0.001), depth_m)), mm


def test_every_millimetre_is_exact():
    mm = np.arange(65536, dtype=np.uint16)
    out = np.zeros_like(mm)
    assert kernels.exact_millimetres(np.zeros(0, np.float32), out[:0])
    assert kernels.exact_millimetres(mm * np.float32(0.001), out)
    np.testing.assert_array_equal(out, mm)


@given(st.lists(st.one_of(
    st.integers(0, 65535).map(lambda mm: np.float32(mm) * np.float32(0.001)),
    st.floats(width=32),
), max_size=8))  # fmt: skip
def test_millimetres_agree_with_numpy(depth):
    depth_m = np.array(depth, np.float32)
    out = np.zeros(len(depth_m), np.uint16)
    exact, mm = plain_millimetres(depth_m)
    assert kernels.exact_millimetres(depth_m, out) == exact
    if exact:
        np.testing.assert_array_equal(out, mm)
