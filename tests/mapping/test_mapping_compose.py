"""The published grid agrees with plain NumPy, wherever the window lies on the torus."""

from __future__ import annotations

import numpy as np
import pytest

from edge.mapping.compose import compose


@pytest.mark.parametrize(
    ("x0", "y0", "shape"),
    [(0, 0, (0, 0)), (0, 0, (16, 16)), (13, 9, (10, 16)), (-7, -40, (16, 5)), (10**6, 3, (1, 1))],
)
@pytest.mark.parametrize("inflated", [100, 50])
def test_compose(x0, y0, shape, inflated):
    rng = np.random.default_rng(0)
    raw = rng.integers(0, 3, (16, 16)).astype(np.uint8)
    near = (rng.integers(0, 4, (16, 16)) // 3).astype(np.uint16)
    rows, columns = (y0 + np.arange(shape[0])) % 16, (x0 + np.arange(shape[1])) % 16
    r, c = raw[np.ix_(rows, columns)], near[np.ix_(rows, columns)]
    out = np.full(shape, 7, np.int8)
    compose(raw, near, x0, y0, inflated, out)
    blocked = np.where(r >= 2, 100, inflated)
    np.testing.assert_array_equal(out, np.where(c > 0, blocked, np.where(r > 0, 0, -1)))
