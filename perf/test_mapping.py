"""Benchmark: map update with frontiers, unknown area, travel-cost field and detector coverage."""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import pytest

from edge import config
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.loop.warmup import warm_mapping
from edge.mapping import grid, layers
from edge.types import Observation

CAMERA = CameraModel.from_hfov(640, 480, math.radians(75))
T_BASE_CAMERA = to_optical(se3(0.1, 0.0, 0.6, pitch_rad=math.radians(5)))
MAPPING = config.MappingConfig()


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_mapping(MAPPING)


def room_depth(T: np.ndarray, half_m: float = 4.0) -> np.ndarray:
    """Return the depth of a square room with pillars (cylinders of 0.2 m) every 2 m."""
    u, v = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    to_optical = np.stack(
        [
            (u - CAMERA.cx_px) / CAMERA.fx_px,
            (v - CAMERA.cy_px) / CAMERA.fy_px,
            np.ones(u.shape),
        ],
        axis=-1,
    )
    rays, origin = to_optical @ T[:3, :3].T, T[:3, 3]
    depth = np.full(u.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, at in ((0, half_m), (0, -half_m), (1, half_m), (1, -half_m), (2, 0.0), (2, 2.5)):
            t = (at - origin[axis]) / rays[..., axis]
            depth = np.minimum(depth, np.where(t > 1e-6, t, np.inf))
        for x, y in itertools.product((-3.0, -1.0, 1.0, 3.0), repeat=2):
            a = (rays[..., :2] ** 2).sum(-1)
            b = rays[..., 0] * (origin[0] - x) + rays[..., 1] * (origin[1] - y)
            c = (origin[0] - x) ** 2 + (origin[1] - y) ** 2 - 0.01
            t = (-b - np.sqrt(b * b - a * c)) / a
            depth = np.minimum(depth, np.where(t > 1e-6, t, np.inf))
    return depth.astype(np.float32)


@functools.cache
def frames() -> list[tuple[np.ndarray, np.ndarray, SE2]]:
    """Return frames of a turn on the spot with drift, so that every view is new."""
    out = []
    for yaw in np.arange(0.0, 2 * math.pi, 0.1):
        pose = SE2(0.1 * math.cos(yaw), 0.1 * math.sin(yaw), yaw)
        T = pose.matrix() @ T_BASE_CAMERA
        out.append((room_depth(T), T, pose))
    return out


def explored_map(cells: int) -> grid.RollingMap:
    """Return a fully explored map: free, with obstacles and unknown specks."""
    m = grid.RollingMap(MAPPING.model_copy(update={"extent_m": cells * MAPPING.resolution_m}))
    m._move_window(0, 0)
    rng = np.random.default_rng(0)
    n = m.window.n
    inner, disc, changed = m._cells.layers, m._cells.disc, m._cells.changed
    inner.raw[:] = rng.random((n, n)) < 0.9998
    bits = np.packbits(inner.raw, axis=1, bitorder="little").view(np.uint64)
    inner.known[:] = bits
    for x, y in rng.integers(0, n, (n * n // 2000, 2)):
        if inner.raw[y, x] < layers.OCCUPIED:
            inner.raw[y, x] = layers.OCCUPIED
            layers.bit_set(inner.known, y, x, True)
            window = ((x - m.window.shift[0]) % n, (y - m.window.shift[1]) % n)
            layers.add_disc(inner, *m.window.shift, *window, 1, disc, (0, 0, n, n), changed)
    m._cells.explored[:] = (0, 0, n, n)
    changed[:] = (0, 0, n, n)
    m._refresh_frontiers(True)
    return m


def numpy_points(depth_m: np.ndarray, T: np.ndarray):
    """Return a function that gives the (n, 3) float32 points of a depth image."""
    v, u = np.indices(depth_m.shape, np.float32)
    x = (u - np.float32(CAMERA.cx_px)) / np.float32(CAMERA.fx_px)
    y = (v - np.float32(CAMERA.cy_px)) / np.float32(CAMERA.fy_px)
    rays = np.stack((x, y, np.ones_like(x)), axis=-1)
    turn, origin = T[:3, :3].astype(np.float32), T[:3, 3].astype(np.float32)
    # einsum, since matrix products run on as many threads as they like.
    return lambda: np.einsum("hwk,jk->hwj", rays * depth_m[..., None], turn) + origin


def update_all_round(m: grid.RollingMap):
    """Return a function that updates the map with the next of `frames`, over and over."""
    views = itertools.cycle(frames())

    def step() -> None:
        depth, _, pose = next(views)
        m.update_depth(depth, CAMERA, pose.matrix(), T_BASE_CAMERA)

    return step


@pytest.mark.parametrize(
    ("cells", "budget"),
    [
        (400, "map_update_grid_400"),
        (1000, "map_update_depth_480x640_grid_1000"),
        (4000, "map_update_grid_4000"),
    ],
)
def test_map_update(benchmark, against, cells, budget):
    """Compare with the first step of an update in plain NumPy: all pixels to points of the map."""
    benchmark.extra_info["budget"] = budget
    against(numpy_points(*frames()[0][:2]))
    m = explored_map(cells)
    benchmark.pedantic(update_all_round(m), rounds=500, warmup_rounds=20)
    assert m.layers.frontier.any()


def test_unknown_ratio_of_200_candidates(benchmark):
    benchmark.extra_info["budget"] = "unknown_ratio_200"
    m = explored_map(1000)
    rng = np.random.default_rng(1)
    xy = rng.uniform(-5, 5, (200, 2)).astype(np.float32)
    out = np.zeros(200, np.float32)
    benchmark.pedantic(m.unknown.ratio, args=(xy, 200, 1.0, out), rounds=500, warmup_rounds=20)
    assert np.ptp(out) > 0


def test_travel_cost_step_in_the_open(benchmark):
    benchmark.extra_info["budget"] = "travel_cost_step"
    m = explored_map(1000)
    benchmark.pedantic(m.travel_cost.step, args=(SE2(0.0, 0.0, 0.0),), rounds=500, warmup_rounds=20)
    assert m.travel_cost.generation > 0


def test_marking_a_searched_image(benchmark):
    """Benchmark: cost that each searched image adds to a tick."""
    benchmark.extra_info["budget"] = "coverage_image"
    m = explored_map(1000)
    views = itertools.cycle(
        Observation(0, 0, pose.matrix(), camera=CAMERA, T_base_camera=T_BASE_CAMERA)
        for _, _, pose in frames()
    )

    def step() -> None:
        m.coverage.on_image(next(views), 3.0, 3)

    benchmark.pedantic(step, rounds=500, warmup_rounds=20)
    assert m.coverage.looks.any()


def test_step_of_the_search_for_a_view(benchmark):
    """Measure the most expensive case: an open hall of 50 m that no image has covered."""
    benchmark.extra_info["budget"] = "coverage_search_step"
    m = explored_map(1000)
    while m.travel_cost.generation == 0:
        m.travel_cost.step(SE2(0.0, 0.0, 0.0))
    m.coverage.on_image(Observation(0, 0, np.eye(4), camera=CAMERA), 3.0, 3)
    benchmark.pedantic(m.coverage.search, args=(m.travel_cost,), rounds=100, warmup_rounds=5)
