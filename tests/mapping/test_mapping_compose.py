"""The published grid agrees with plain NumPy, wherever the window is on the torus."""

from __future__ import annotations

import numpy as np
import pytest

from edge.mapping import layers as ly
from edge.mapping.compose import compose


@pytest.mark.parametrize(
    ("x0", "y0", "shape"),
    [(0, 0, (0, 0)), (0, 0, (16, 16)), (13, 9, (10, 16)), (-7, -40, (16, 5)), (10**6, 3, (1, 1))],
)
@pytest.mark.parametrize("inflated", [100, 50])
def test_compose(x0, y0, shape, inflated):
    rng = np.random.default_rng(0)
    layers, body = ly.make_layers(64), ly.disc_half_widths(0.0)
    layers.raw[:] = rng.integers(0, 3, (64, 64))
    layers.near[:] = np.maximum(rng.integers(0, 4, (64, 64)) // 3, layers.raw // 2)
    layers.trail[:, 0] = rng.integers(0, 2**63, 64, dtype=np.uint64)
    trail = np.unpackbits(layers.trail.view(np.uint8), axis=1, bitorder="little").astype(bool)
    here = np.ix_((y0 + np.arange(shape[0])) % 64, (x0 + np.arange(shape[1])) % 64)
    raw, near, trail = layers.raw[here], layers.near[here], trail[here]
    out = np.full(shape, 7, np.int8)
    compose(layers, body, x0, y0, inflated, True, out)
    expected = np.where(raw > 0, 0, -1)
    expected[(near > 0) & ~trail] = inflated
    expected[raw >= 2] = 100
    np.testing.assert_array_equal(out, expected)
