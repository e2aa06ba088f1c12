"""VL-Nav eq. 6 on bit planes against a breadth-first search."""

from __future__ import annotations

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.mapping.grid import RollingMap


def random_map(rng: np.random.Generator) -> RollingMap:
    """Random free, occupied and unknown patches, a window whose seam is anywhere."""
    grid = RollingMap(twins.SMALL.model_copy(update={"inflation_m": 0.06}))
    twins.move_to(grid, *(int(v) for v in rng.integers(-500, 500, 2)))
    n, shift = grid.window.n, grid.window.shift
    for _ in range(60):
        x, y = (int(v) for v in rng.integers(0, n - 12, 2))
        for dy in range(int(rng.integers(1, 12))):
            for dx in range(int(rng.integers(1, 12))):
                sy, sx = (y + dy + shift[1]) % n, (x + dx + shift[0]) % n
                if grid.layers.raw[sy, sx] == 0:
                    twins.set_free(grid, x + dx, y + dy)
    for _ in range(300):
        twins.occupy(grid, *(int(v) for v in rng.integers(0, n, 2)))
    return grid


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.3, 1.0, 1.55]))
def test_the_ratio_agrees_with_a_search(seed, radius_m):
    rng = np.random.default_rng(seed)
    grid = random_map(rng)
    n, origin = grid.window.n, np.array(grid.window.origin)
    cells = np.concatenate([rng.integers(-3, n + 3, (12, 2)), [[0, 0], [n - 1, n - 1], [0, n - 1]]])
    xy = ((cells + origin + 0.5) * grid.resolution_m).astype(np.float32)
    out = np.full(len(xy) + 1, 7.0, np.float32)
    grid.unknown.ratio(xy, len(xy), radius_m, out)
    state = twins.states(grid)
    expected = [
        twins.unknown_ratio(state, int(x), int(y), radius_m / grid.resolution_m) for x, y in cells
    ]
    np.testing.assert_allclose(out[:-1], expected, atol=1e-6)
    assert out[-1] == 7.0, "nothing beyond n is written"


def test_unknown_cells_behind_a_wall_do_not_count():
    grid = RollingMap(twins.SMALL)
    for yaw in np.arange(0, 6.4, 0.2):
        twins.look(grid, twins.SE2(0, 0, yaw), twins.room(1.5))
    out = np.zeros(2, np.float32)
    grid.unknown.ratio(np.array([[0.9, 0.0], [4.0, 0.0]], np.float32), 2, 1.0, out)
    assert out[0] == 0.0
    assert out[1] == 1.0


def test_a_radius_that_does_not_fit_is_an_error():
    grid = RollingMap(twins.SMALL)
    with pytest.raises(ValueError, match=r"at most 1\.55 m are possible; set mapping\."):
        grid.unknown.ratio(np.zeros((1, 2), np.float32), 1, 1.6, np.zeros(1, np.float32))
