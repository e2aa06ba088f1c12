"""Expected gain of a view: against plain NumPy, and for cells seen twice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping_twins import SMALL, look, writable

from edge.geometry import SE2, wrap_angle
from edge.mapping import gain as g
from edge.mapping.grid import RollingMap
from edge.mapping.layers import FREE, OCCUPIED, UNSEEN

FOV = math.radians(75)


def area_twin(raw, near, x, y, steps, cell_m, decay):
    """Each ray in turn, as far as it goes; the map begins at the world's origin."""
    total = 0.0
    for k in range(g.RAYS):
        angle, open_ = 2 * math.pi * k / g.RAYS, 1.0
        for s in range(1, steps + 1):
            r = s * g.STEP_CELLS
            cx, cy = math.floor(x + r * math.cos(angle)), math.floor(y + r * math.sin(angle))
            inside = 0 <= cx < len(raw) and 0 <= cy < len(raw)
            if not inside or raw[cy, cx] >= OCCUPIED or near[cy, cx] >= g.CROWDED:
                break
            if raw[cy, cx] == UNSEEN:
                open_ *= decay
                ring_m = 2 * math.pi / g.RAYS * s * cell_m
                total += open_ * ring_m * cell_m
    return total


def test_a_map_without_a_place_shows_nothing():
    _, _, area_m2 = RollingMap(SMALL).gain.best_spin(SE2(0.0, 0.0, 0.0), 0.0, FOV)
    assert area_m2 == 0.0


@given(seed=st.integers(0, 2**32 - 1))
def test_the_area_agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    grid = RollingMap(SMALL)
    grid.window.placed = True
    layers, n = writable(grid), grid.window.n
    raw = layers.raw
    raw[:] = rng.choice([UNSEEN, FREE, OCCUPIED], raw.shape, p=[0.5, 0.49, 0.01])
    layers.near[:] = rng.choice([0, g.CROWDED - 1, g.CROWDED], raw.shape, p=[0.5, 0.49, 0.01])
    res = grid.resolution_m
    xy_m = rng.uniform(0, n * res, (5, 2)).astype(np.float32)
    out = np.full(5, -1.0, np.float32)
    grid.gain.around(xy_m, np.array([3, 1], np.int32), 2, out)
    steps = int(g.SAFE_SHARE * SMALL.range_m / (g.STEP_CELLS * res))
    decay = math.exp(-g.STEP_CELLS * res / g.OPEN_M)
    for i in (3, 1):
        x, y = (float(v) / res for v in xy_m[i])
        expected = area_twin(raw, layers.near, x, y, steps, g.STEP_CELLS * res, decay)
        assert out[i] == pytest.approx(expected, rel=0.02, abs=0.05)
    assert out[[0, 2, 4]].tolist() == [-1, -1, -1]


@pytest.mark.parametrize(
    ("rays", "ahead", "expected"),
    [
        ([], 0.0, (0, 0)),
        # A quarter turn either way, the field of view counted in.
        ([16], 0.0, (+1, math.pi / 2 - FOV / 2)),
        ([48], 0.0, (-1, math.pi / 2 - FOV / 2)),
        # Behind: whichever way is shorter.
        ([31], 0.0, (+1, 31 / 32 * math.pi - FOV / 2)),
        ([33], 0.0, (-1, 31 / 32 * math.pi - FOV / 2)),
        # Both sides: on from the nearer one, all the way round to the farther.
        ([16, 40], 0.0, (+1, 40 / 32 * math.pi - FOV / 2)),
        ([0], math.pi / 2, (-1, math.pi / 2 - FOV / 2)),
    ],
)  # fmt: skip
def test_a_spin_covers_every_ray_the_shorter_way_round(rays, ahead, expected):
    ray = np.zeros(g.RAYS)
    ray[rays] = 0.5
    turn, sweep, area = g.best_sweep(ray, np.zeros(g.RAYS, np.bool_), FOV, ahead)
    assert (np.sign(turn), sweep) == (expected[0], pytest.approx(max(expected[1], 0.0)))
    assert abs(turn) <= 2 * math.pi / 3 + 1e-9
    assert area == pytest.approx(0.5 * len(rays))


def test_no_direction_is_looked_along_twice_from_one_place():
    grid = RollingMap(SMALL)
    here = SE2(0.0, 0.0, 0.0)
    look(grid, here, [])
    turned = []
    for _ in range(8):
        heading, turn_rad, area_m2 = grid.gain.best_spin(here, 0.0, FOV)
        if area_m2 == 0.0:
            break
        turned.append(turn_rad)
        # The camera sees nothing there, however often it looks.
        way = np.sign(wrap_angle(heading - here.yaw_rad))
        for yaw in np.linspace(here.yaw_rad, here.yaw_rad + way * 0.9, 4):
            grid.gain.on_view(SE2(0.05, 0.0, yaw), 0.0, FOV)
        here = SE2(0.0, 0.0, yaw)
    else:
        pytest.fail(f"turned on and on: {turned}")
    assert turned == sorted(turned, reverse=True)
    assert grid.gain.best_spin(SE2(2 * g.SAME_PLACE_M, 0.0, 0.0), 0.0, FOV)[2] > 0.0
