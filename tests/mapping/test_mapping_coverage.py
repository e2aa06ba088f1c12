"""Coverage of the detector: kernels against twins, rolling, and an end of the search."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_twins import CAMERA, T_BASE_CAMERA, complete, look, room, seen_around

from edge.geometry import SE2, se3, to_optical
from edge.mapping import coverage as cv
from edge.mapping.coverage import COUNT, KEEP, MIN_VIEW_M2, WRITE_OFF, Coverage
from edge.mapping.grid import RollingMap
from edge.mapping.layers import FREE, OCCUPIED, make_layers
from edge.mapping.window import Window
from edge.types import Observation

BITS = 2


def seen_from(pose: SE2, mount: np.ndarray = T_BASE_CAMERA, camera=CAMERA) -> Observation:
    return Observation(0, 0, pose.matrix(), camera=camera, T_base_camera=mount)


def explored(half_m: float = 2.0) -> RollingMap:
    """Return a square room, observed all around from its middle."""
    grid = seen_around(room(half_m))
    complete(grid, SE2(0.0, 0.0, 0.0))
    return grid


def searched(grid: RollingMap) -> SE2 | None:
    grid.coverage.restart_search()
    while not grid.coverage.search(grid.travel_cost):
        pass
    return grid.coverage.view


def window(grid: RollingMap) -> np.ndarray:
    """Return the view counts in window coordinates."""
    looks, bits = grid.coverage.looks, grid.coverage._place_bits
    (x, y), m = grid.window.origin, len(looks)
    return np.roll(looks, (-((y >> bits) % m), -((x >> bits) % m)), axis=(0, 1))


def show_twin(raw, looks, x, y, first, between, rays, near, far, enough, then):
    """Return the new area of each ray and update `looks`: a twin of `show`, in the window."""
    n, shown, fresh = len(raw), set(), []
    for k in range(rays):
        angle, anew = first + between * k, 0
        for along in np.arange(0.0, far + 1e-9, max(1.0, 0.25 * 2**BITS)):
            cx, cy = (
                int(np.floor(x + along * math.cos(angle))),
                int(np.floor(y + along * math.sin(angle))),
            )
            if not (0 <= cx < n and 0 <= cy < n) or raw[cy, cx] == 0:
                break
            place = (cy >> BITS, cx >> BITS)
            if along >= near and place not in shown:
                shown.add(place)
                anew += looks[place] < enough
            if raw[cy, cx] >= OCCUPIED:
                break
        fresh.append(anew)
    for place in shown:
        if then == COUNT:
            looks[place] = min(looks[place] + 1, 127)
        elif then == WRITE_OFF and looks[place] < enough:
            looks[place] = 127
    return fresh


def random_world(seed: int, n: int = 128):
    """(layers, looks, shift, origin) of a map with walls and unseen parts; a roll of any size."""
    rng = np.random.default_rng(seed)
    layers = make_layers(n)
    raw = np.full((n, n), FREE, np.uint8)
    for _ in range(12):
        x, y, w, h = *rng.integers(0, n, 2), *rng.integers(1, n // 6, 2)
        raw[y : y + h, x : x + w] = rng.choice([0, OCCUPIED, OCCUPIED + 1])
    origin = tuple((64 * rng.integers(-9, 9, 2)).tolist())
    shift = origin[0] % n, origin[1] % n
    layers.raw[:] = np.roll(raw, (shift[1], shift[0]), axis=(0, 1))
    looks = rng.choice([0, 1, 2, 3, 126, 127], (n >> BITS, n >> BITS)).astype(np.uint8)
    stored = np.roll(looks, (shift[1] >> BITS, shift[0] >> BITS), axis=(0, 1))
    return rng, layers, raw, looks, stored, shift, origin


def test_nothing_is_searched_before_a_camera_looked():
    assert searched(explored()) is None


@given(seed=st.integers(0, 2**32 - 1), then=st.sampled_from([KEEP, COUNT, WRITE_OFF]))
def test_show_agrees_with_its_twin(seed, then):
    rng, layers, raw, looks, stored, shift, _ = random_world(seed)
    x, y = rng.uniform(-5, 133, 2)
    first, between, rays = rng.uniform(-7, 7), rng.uniform(0.01, 0.2), int(rng.integers(1, 60))
    near, far, enough = rng.uniform(0, 20), rng.uniform(0, 70), int(rng.integers(1, 128))
    fresh = np.zeros(cv.MAX_RAYS, np.int32)
    total = cv.show(
        layers.raw, stored, BITS, *shift, x, y, first, between, rays, near, far, enough, then, fresh
    )
    expected = show_twin(raw, looks, x, y, first, between, rays, near, far, enough, then)
    assert fresh[:rays].tolist() == expected
    assert total == sum(expected)
    back = np.roll(stored, (-(shift[1] >> BITS), -(shift[0] >> BITS)), axis=(0, 1))
    np.testing.assert_array_equal(back, looks)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), work=st.sampled_from([1, 3000, 10**9]))
def test_the_best_view_is_independent_of_the_step_size(seed, work):
    n, side = 64, 1 << BITS
    rng, layers, raw, looks, stored, shift, origin = random_world(seed, n)
    reached = (raw == FREE) & (rng.random(raw.shape) < 0.05)
    steps = np.where(reached, rng.integers(1, 900, raw.shape), 0).astype(np.int32)
    bits = np.packbits(raw > 0, axis=1, bitorder="little").view(np.uint64)
    layers.known[:] = np.roll(bits, (shift[1], shift[0] >> 6), axis=(0, 1))
    distance = np.roll(steps, (shift[1], shift[0]), axis=(0, 1))
    fov, near, far, start, least, enough = 1.1, 5.0, 20.0, 20.0, 4, 3
    rect = (origin[0] + 3, origin[1], origin[0] + n, origin[1] + n - 9)
    best, fresh, at, calls = np.zeros(4), np.zeros(cv.MAX_RAYS, np.int32), 0, 0
    while True:
        at = cv.best_view(
            layers, distance, *rect, *origin, stored, BITS, enough, fov, near, far, start, least,
            fresh, at, work, best,
        )  # fmt: skip
        calls += 1
        if at == 0:
            break
    assert calls == 1 or work < 10**9

    between, width = cv.sector(fov, far, BITS)
    circle = round(2 * math.pi / between)
    worths = {0.0}
    for wy in range(0, n - 9, side):
        for wx in range(side, n, side):  # the first lattice point from 3 on
            if not steps[wy, wx]:
                continue
            shown = show_twin(
                raw, looks, wx + 0.5, wy + 0.5, 0.0, between, circle, near, far, enough, KEEP
            )
            cost = start + (steps[wy, wx] - 1) / 5
            sums = np.convolve(shown + shown, np.ones(width), "valid")
            if sums.max() >= least:
                worths.add(sums.max() / cost)
    assert best[0] == pytest.approx(max(worths))
    if best[0] > 0:  # and it is there, in that direction
        x, y = int(best[1]) - origin[0], int(best[2]) - origin[1]
        first = best[3] - 0.5 * (width - 1) * between
        shown = show_twin(
            raw, looks, x + 0.5, y + 0.5, first, between, width, near, far, enough, KEEP
        )
        cost = start + (steps[y, x] - 1) / 5
        assert sum(shown) / cost >= 0.99 * best[0]  # in a circle other rays may claim some


@pytest.mark.parametrize("how", ["looked from there", "in vain"])
def test_the_series_of_views_ends(how):
    grid = explored()
    coverage = grid.coverage
    coverage.on_image(seen_from(SE2(0.0, 0.0, 0.0)), 1.6, 2)
    views = []
    while (view := searched(grid)) is not None:
        assert grid.travel_cost.distance_m(view.x_m, view.y_m) < math.inf
        assert grid.state_at(view.x_m, view.y_m) == 0
        assert coverage.area_m2(view) > 0.9 * MIN_VIEW_M2
        views.append(view)
        before = np.count_nonzero(window(grid) >= 2)
        if how == "looked from there":
            for _ in range(2):
                ahead = view
                coverage.on_image(seen_from(ahead, to_optical(se3(0.0, 0.0, 0.6))), 1.6, 2)
            assert not coverage.is_worth_visiting(view)
            assert coverage.area_m2(view) < 1.1 * MIN_VIEW_M2
        coverage.write_off(view)
        assert coverage.area_m2(view) == 0.0
        assert np.count_nonzero(window(grid) >= 2) > before
        assert len(views) < 60
    assert len(views) > 3
    if how == "looked from there":
        # All the floor except areas too small for a view.
        m = np.arange(-1.6, 1.7, 0.2)
        cells = [place(grid, x, y) for x in m for y in m]
        assert sum(c >= 2 for c in cells) > 0.9 * len(cells)


def place(grid: RollingMap, x_m: float, y_m: float) -> int:
    """Return the number of views of a point's cell."""
    side_m = grid.resolution_m * 2**grid.coverage._place_bits
    x, y = math.floor(x_m / side_m), math.floor(y_m / side_m)
    m = len(grid.coverage.looks)
    return int(grid.coverage.looks[y % m, x % m])


def test_a_camera_that_looks_aside_is_turned_there():
    grid = explored()
    mount = to_optical(se3(0.1, 0.0, 0.6))
    left = SE2(0.0, 0.0, math.pi / 2).matrix() @ mount
    grid.coverage.on_image(seen_from(SE2(0.0, 0.0, 0.0), left), 3.0, 1)
    assert grid.coverage.camera_yaw_rad == pytest.approx(math.pi / 2)
    assert place(grid, 0.1, 1.5) == 1
    assert place(grid, 1.5, 0.1) == 0


@given(
    moves=st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=1, max_size=5),
    seed=st.integers(0, 2**32 - 1),
)
def test_rolling_clears_only_cells_that_leave_the_window(moves, seed):
    rng = np.random.default_rng(seed)
    n = 128
    window, m = Window(n, 0.05), n >> BITS
    cover = Coverage(make_layers(n), window)
    known: dict[tuple[int, int], int] = {}
    for move in moves:
        for axis, cells in enumerate(move):
            cover.roll(axis, 64 * cells)
            window.origin = tuple(
                at + 64 * cells * (k == axis) for k, at in enumerate(window.origin)
            )
        px, py = (at >> BITS for at in window.origin)
        known = {(x, y): v for (x, y), v in known.items() if px <= x < px + m and py <= y < py + m}
        for x, y in known:
            assert cover.looks[y % m, x % m] == known[x, y]
        assert np.count_nonzero(cover.looks) == len(known)
        for x, y in rng.integers(0, m, (30, 2)):
            known[int(px + x), int(py + y)] = value = int(rng.integers(1, 128))
            cover.looks[(py + y) % m, (px + x) % m] = value


def test_coverage_rolls_with_the_map():
    grid = explored()
    grid.coverage.on_image(seen_from(SE2(0.0, 0.0, 0.0)), 3.0, 1)
    for x in np.arange(0.0, 40.0, 1.0):
        look(grid, SE2(float(x), 0.0, 0.0), [])
    assert not grid.coverage.looks.any()
