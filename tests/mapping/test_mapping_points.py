"""Points, polar bins, local ground: kernels against twins, and ground against obstacles."""

from __future__ import annotations

import math

import mapping_twins as twins
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import config
from edge.geometry import SE2, CameraModel, se3
from edge.mapping import points
from edge.mapping.grid import CLEAR_AFTER, RollingMap
from edge.mapping.ground import find_floor, fit_floor, sweep_ground
from edge.mapping.layers import OCCUPIED
from edge.mapping.scans import pixel_samples

F = np.float32
T_BASE_CAMERA = twins.T_BASE_CAMERA
POLAR = points.make_polar(3.0, 0.05)


def random_scan(seed: int, n: int):
    rng = np.random.default_rng(seed)
    scan = points.make_scan(POLAR, max(n, 1))
    scan.xyz[:2, :n] = rng.uniform(-4, 4, (2, n))
    # Some in few directions, dense enough for runs of ground.
    ray, reach_m = rng.choice([0.3, 1.7, -2.0], n // 2), rng.uniform(0.2, 3.5, n // 2)
    scan.xyz[:2, : n // 2] = reach_m * np.cos(ray), reach_m * np.sin(ray)
    scan.xyz[2, :n] = rng.choice([0.0, 0.2, 0.3, 0.8, 1.5, -0.4], n) + rng.normal(0, 0.02, n)
    half = POLAR.bin_of.shape[0] // 2
    args = (F(0.6), F(3.0), F(20.0), F(half + 0.3), F(half + 0.8))
    return scan, args


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 400),
    share=st.sampled_from([1.0, 0.7]),
    high_m=st.sampled_from([0.25, 1.0]),
    lean=st.sampled_from([(0.0, 0.0), (0.05, -0.1)]),
)
def test_point_kernels_agree_with_their_twins(seed, n, share, high_m, lean):
    scan, args = random_scan(seed, n)
    hits = int(share * n)
    within = points.bin_points(n, hits, *args, POLAR, scan)
    lowest, far_slope, cell, z_m = twins.scan_twin(scan.xyz[:, :n], hits, *args, POLAR)
    np.testing.assert_array_equal(scan.cell[:within], cell)
    np.testing.assert_array_equal(scan.z_m[:within], z_m)
    np.testing.assert_array_equal(scan.lowest_m, lowest)
    np.testing.assert_allclose(scan.far_slope, far_slope, rtol=1e-5)

    floor = np.array([0.0, *lean])
    total, count = sweep_ground(scan, POLAR, floor, 0.6, 0.3, 0.1, 3.0, 20.0)
    ground, passing, reach, near = twins.sweep_twin(
        lowest, scan.far_slope, POLAR, 0.6, floor, 0.3, 0.1, 3.0
    )
    assert count == len(near)
    assert total == pytest.approx(sum(near), abs=1e-4)
    touched = ~np.isnan(ground[:, 0])
    np.testing.assert_allclose(scan.ground_m[touched], ground[touched], atol=1e-5)
    np.testing.assert_allclose(scan.pass_slope[touched], passing[touched], rtol=1e-5)
    # A slope that rounds to the other side of its limit in float32 ends a sector elsewhere.
    assert np.count_nonzero(np.abs(scan.reach_m - reach) > 1e-5) <= 1

    points.classify(within, scan, POLAR, 0.1, high_m, 1.0)
    points.extend_obstacles_up(within, scan, POLAR, high_m, 1.0)
    expected = twins.classify_twin(cell, z_m, scan.ground_m, POLAR, 0.1, high_m, 1.0)
    np.testing.assert_array_equal(scan.seen, expected)
    ys, xs = np.nonzero(scan.seen)
    x0, y0, x1, y1 = scan.box
    assert len(xs) == 0 or (xs.min() >= x0 and xs.max() < x1 and ys.min() >= y0 and ys.max() < y1)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 4000),
    floor=st.tuples(st.floats(-0.6, 0.1), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    base_z=st.sampled_from([0.0, -0.3, 2.0]),
)
def test_the_search_for_the_floor_agrees_with_its_twin(seed, n, floor, base_z):
    rng = np.random.default_rng(seed)
    scan, (_, _, inv_res, fx, fy) = random_scan(seed, n)
    xyz = scan.xyz[:, :n]
    xyz[2] = floor[0] + floor[1] * xyz[0] + floor[2] * xyz[1] + rng.normal(0, 0.02, n)
    xyz[2] += rng.choice([0.0, 0.4, -0.3], n, p=[0.8, 0.1, 0.1])
    points.bin_points(n, n, F(0.6), F(3.0), inv_res, fx, fy, POLAR, scan)
    for search_m in (1.5, 3.0):
        found = find_floor(scan.lowest_m, POLAR, 0.6, base_z, 0.1, search_m, np.ones((2, 64)))
        expected = twins.find_twin(scan.lowest_m, POLAR, 0.6, base_z, 0.1, search_m)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        fitted = np.array([floor[0], 1.0, 1.0])
        fits = fit_floor(scan.lowest_m, POLAR, 0.6, 0.1, search_m, fitted)
        plane = twins.fit_twin(scan.lowest_m, POLAR, 0.6, floor[0], 0.1, search_m)
        assert fits == (plane is not None)
        level = np.array([floor[0], 0.0, 0.0])
        np.testing.assert_allclose(fitted, plane if fits else level, atol=1e-5)


@pytest.mark.parametrize("bad", [np.nan, 0.0, np.inf, -np.inf, -1.0, 1e6, 1e30, 3.4e38])
def test_depth_points_agree_with_numpy_and_drop_invalid_pixels(bad):
    camera = CameraModel.from_hfov(40, 30, 1.2)
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 4.0, (30, 40)).astype(F)
    depth[rng.random(depth.shape) < 0.3] = bad
    T = (SE2(1.0, 2.0, 0.7).matrix() @ T_BASE_CAMERA)[:3].astype(F)
    column = ((np.arange(40) - camera.cx_px) / camera.fx_px).astype(F)
    row = ((np.arange(30) - camera.cy_px) / camera.fy_px).astype(F)
    xyz = np.zeros((3, 1200), F)
    n = points.from_depth(depth, 3, 2, column, row, T, F(0.1), xyz)
    v, u = np.meshgrid(np.arange(1, 30, 2), np.arange(1, 40, 3), indexing="ij")
    d = depth[v, u]
    good = (d > 0.1) & (d < 1e6)
    optical = np.stack([d * column[u], d * row[v], d])[:, good]
    expected = T[:, :3] @ optical
    expected[2] += T[2, 3]
    assert n == good.sum()
    np.testing.assert_allclose(xyz[:, :n], expected, atol=1e-5)

    lost = np.zeros(POLAR.sectors, np.uint64)
    points.lost_rays(depth, 3, 2, column, row, T, F(0.1), POLAR, lost)
    rays = T[:, :3] @ np.stack([column[u], row[v], np.ones_like(column[u])])[:, ~good]
    slope = rays[2] / np.hypot(rays[0], rays[1])
    rays, slope = rays[:, np.abs(slope + 0.25) < 0.5], slope[np.abs(slope + 0.25) < 0.5]
    sector = (np.arctan2(rays[1], rays[0]) + math.pi) / (2 * math.pi) * POLAR.sectors
    bit = ((slope + 0.75) * 64).astype(int)
    marked = [(s, k) for s in np.flatnonzero(lost) for k in range(64) if int(lost[s]) >> k & 1]
    assert marked
    for s, k in marked:  # a sector is that of a cell, whose middle may be in the next
        assert (np.abs(sector - s - 0.5)[bit == k] < 1.5).any()
    assert len({k for _, k in marked} ^ set(bit.tolist())) == 0


def test_cloud_points_agree_with_numpy_and_drop_invalid_points():
    rng = np.random.default_rng(1)
    cloud = rng.uniform(-5, 5, (200, 3)).astype(F)
    cloud[::7, 1] = np.inf
    cloud[3::11, 2] = np.nan
    cloud[4::13, 2] = np.inf
    cloud[8::17, 2] = -np.inf
    cloud[5], cloud[6] = 1e6, 0.0
    cloud[15], cloud[16] = (2e6, 0.0, np.inf), (0.0, 0.0, np.inf)
    T = se3(1, 2, 0.5, 0.1, 0.4, 1.0)[:3].astype(F)
    xyz = np.zeros((3, 200), F)
    hits, n = points.from_cloud(cloud, T, F(0.1), xyz)
    keep = np.isfinite(cloud).all(axis=1)
    ends = np.isfinite(cloud[:, :2]).all(axis=1) & (cloud[:, 2] == np.inf)
    keep[[5, 6]] = ends[[15, 16]] = False
    expected = T[:, :3] @ np.concatenate(
        [cloud[keep], np.where([1, 1, 0], cloud[ends], 0)]
    ).T.astype(F)
    expected[2] += T[2, 3]
    assert (hits, n) == (keep.sum(), keep.sum() + ends.sum())
    np.testing.assert_allclose(xyz[:, :n], expected, atol=1e-5)


@given(
    seed=st.integers(0, 2**32 - 1),
    tilt_rad=st.sampled_from([0.0, 0.2]),
    radius_m=st.sampled_from([0.05, 0.3, 0.9]),
)
def test_the_points_of_the_robot_are_dropped_as_numpy_does(seed, tilt_rad, radius_m):
    rng = np.random.default_rng(seed)
    T_map_base = se3(*rng.uniform(-9, 9, 3), tilt_rad, -tilt_rad, rng.uniform(-3, 3))
    sensor_m = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.3, 1.0)])
    at_m = T_map_base[:3, :3] @ sensor_m + T_map_base[:3, 3]
    base_m = rng.uniform(-1.0, 1.0, (3, 300))
    in_map = T_map_base[:3, :3] @ base_m + T_map_base[:3, 3:]
    xyz = (in_map - [[at_m[0]], [at_m[1]], [0.0]]).astype(F)
    before = xyz.copy()
    axes, sensor = T_map_base[:3, :3].astype(F, order="C"), sensor_m.astype(F)
    left, hits = points.drop_self_points(300, 200, xyz, axes, sensor, F(at_m[2]), radius_m, 1.0)
    keep = np.hypot(base_m[0], base_m[1]) >= radius_m
    assert hits == np.count_nonzero(keep[:200])
    np.testing.assert_array_equal(xyz[:, :left], before[:, keep])


@given(
    slopes=st.lists(st.floats(-0.9, 0.9), max_size=9),
    passes=st.floats(-0.9, 0.9),
    d=st.floats(0.1, 5.0),
    over_m=st.floats(0.1, 2.0),
)
def test_a_cell_is_open_as_its_rays_say(slopes, passes, d, over_m):
    """Three lost rays between the floor and the lowest that passes close it, to a bit's width."""
    slopes = [slope for slope in slopes if -0.75 <= slope < 0.25]
    lost = np.uint64(sum({1 << int((slope + 0.75) * 64) for slope in slopes}))
    below_m = over_m + passes * d
    is_open = points.is_open(lost, below_m, over_m, F(d), 0.1, 1.0)
    floor, slack = -over_m / max(d, 1.0), 1.1 / 64
    hidden = [s for s in slopes if floor < s < passes]
    surely = [s for s in slopes if floor + slack < s < passes - slack]
    if below_m < 0.1:
        assert is_open
    elif below_m > max(1.0, over_m):
        assert not is_open
    elif len(hidden) < 3:
        assert is_open
    elif len({int((s + 0.75) * 64) for s in surely}) >= 3:
        assert not is_open


VGA = CameraModel.from_hfov(640, 480, math.radians(75))
QVGA = CameraModel.from_hfov(320, 256, math.radians(75))


@pytest.mark.parametrize("camera", [VGA, QVGA], ids=["480x640", "256x320"])
@pytest.mark.parametrize(("low_m", "height_m"), [(0.05, 0.1), (0.10, 0.2)])
def test_skipping_pixels_misses_no_obstacle_of_a_decimetre(camera, low_m, height_m):
    """Random boxes 0.1 m wide and deep on the floor, anywhere in view, leave an obstacle.

    0.1 m high ones where obstacles begin at 0.05 m; where they begin at 0.1 m, ones that stand
    out by 0.1 m.
    """
    rng = np.random.default_rng(2)
    for _ in range(15):
        r, bearing = rng.uniform(1.2, 4.85), rng.uniform(-0.55, 0.55)
        x, y = 0.1 + r * math.cos(bearing), r * math.sin(bearing)
        cube = (x - 0.05, y - 0.05, 0.0, x + 0.05, y + 0.05, height_m)
        grid = RollingMap(config.MappingConfig(inflation_m=0.0, obstacle_min_m=low_m))
        depth = twins.render(camera, T_BASE_CAMERA, [cube])
        grid.update_depth(depth, camera, np.eye(4), T_BASE_CAMERA)
        assert (grid.layers.raw >= OCCUPIED).any(), (r, bearing)


def test_every_obstacle_of_a_decimetre_is_sampled_twice_or_more():
    """The stride itself: 0.1 m at full range spans two samples across, four up."""
    for width in (160, 320, 640, 1280, 1920):
        camera = CameraModel.from_hfov(width, width * 3 // 4, math.radians(75))
        range_m = config.MappingConfig().range_m
        span = 0.1 / range_m * camera.fx_px
        across, up = pixel_samples(camera, range_m).strides
        assert across == 1 or span / across >= 2.0
        assert up == 1 or span / up >= 4.0


def tilted_lidar(boxes, slope=0.0, rings=40, columns=360):
    """Return a map-frame cloud of a LiDAR 0.6 m up, -35 to +25 degrees; a ramp begins at x = 1."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-math.pi, math.pi, columns, endpoint=False),
        np.radians(np.linspace(-35, 25, rings)),
    )
    rays = np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    origin = np.array([0.0, 0.0, 0.6])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -origin[2] / rays[:, 2]
        t = np.where(t > 0, t, np.inf)
        ramp = -(origin[2] + slope) / (rays[:, 2] - slope * rays[:, 0])
        t = np.where((t * rays[:, 0] > 1) | ~np.isfinite(t) & (rays[:, 0] > 0), ramp, t)
        t = np.where(t > 0, t, np.inf)
        for box in boxes:
            a, b = (np.array(box[:3]) - origin) / rays, (np.array(box[3:]) - origin) / rays
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            t = np.where((enter <= leave) & (enter > 0), np.minimum(t, enter), t)
    return np.where(np.isfinite(t)[:, None], t[:, None] * rays, np.inf).astype(F)


def lidar_map(boxes, slope=0.0):
    grid = RollingMap(config.MappingConfig(input="cloud", range_m=4.0, inflation_m=0.0))
    T_base_lidar = se3(0, 0, 0.6, pitch_rad=math.radians(23))
    T = SE2(0.0, 0.0, 0.4).matrix() @ T_base_lidar
    with np.errstate(invalid="ignore"):
        cloud = tilted_lidar(boxes, slope) @ T[:3, :3].astype(F)
    grid.update_cloud(np.ascontiguousarray(cloud), SE2(0.0, 0.0, 0.4).matrix(), T_base_lidar)
    return grid


def test_floor_obstacle_and_overhang_are_distinguished_for_a_tilted_lidar():
    grid = lidar_map([(2, -0.5, 0, 2.3, 0.5, 0.5), (-0.5, 2, 1.3, 0.5, 3, 1.5)])
    assert grid.state_at(2.01, 0.01) == 100
    assert grid.state_at(1.5, 0.0) == 0
    assert grid.state_at(0.0, 2.5) == 0, "free under an overhang"
    assert grid.state_at(3.0, 0.0) == -1, "hidden behind the obstacle"


def test_a_ramp_is_free_and_an_obstacle_on_it_occupied():
    ramp = lidar_map([], slope=0.15)
    assert not (twins.states(ramp) == 100).any()
    assert ramp.state_at(3.0, 0.0) == 0, "floor is 0.3 m up here"
    busy = lidar_map([(2.0, -0.3, 0.0, 2.2, 0.3, 0.7)], slope=0.15)
    assert busy.state_at(2.01, 0.01) == 100


def test_rays_stop_at_a_drop_in_the_floor():
    grid = RollingMap(config.MappingConfig(input="cloud", inflation_m=0.0))
    x = np.linspace(0.5, 4.0, 400)
    y = np.linspace(-0.3, 0.3, 40)
    xx, yy = (a.ravel() for a in np.meshgrid(x, y))
    zz = np.where(xx > 2.0, -1.0, 0.0) - 0.5
    grid.update_cloud(np.stack([xx, yy, zz], axis=1).astype(F), np.eye(4), se3(z_m=0.5))
    assert grid.state_at(1.5, 0.0) == 0
    assert grid.state_at(3.0, 0.0) == -1


@pytest.mark.parametrize("beams", [180, 360, 720])
@pytest.mark.parametrize(("range_m", "end_m"), [(4.0, 2.0), (5.0, 2.0), (5.0, 12.0)])
def test_a_beam_without_a_return_only_frees_cells(beams, range_m, end_m):
    """Also between beams that are two degrees apart."""
    angles = 2 * np.pi / beams * np.arange(beams)
    x, y = end_m * np.cos(angles), end_m * np.sin(angles)
    cloud = np.stack([x, y, np.full(beams, np.inf)], axis=1).astype(F)
    grid = RollingMap(config.MappingConfig(input="cloud", range_m=range_m, inflation_m=0.0))
    grid.update_cloud(cloud, np.eye(4), se3(z_m=0.2))
    for angle in np.radians(np.arange(0, 360, 0.5)):
        c, s = math.cos(angle), math.sin(angle)
        states = [
            grid.state_at(r * c, r * s) for r in np.arange(0.2, min(end_m, range_m) - 0.2, 0.1)
        ]
        assert set(states) == {0}
        assert grid.state_at((end_m + 0.2) * c, (end_m + 0.2) * s) == -1
    assert not (twins.states(grid) == 100).any()


def test_beams_without_a_return_free_nothing_behind_obstacles():
    wall = np.radians(np.arange(-20.0, 21.0))
    cloud = np.zeros((360, 3), F)
    angles = np.radians(np.arange(360.0))
    near = np.abs((angles + np.pi) % (2 * np.pi) - np.pi) <= wall.max() + 1e-6
    r = np.where(near, 1.52 / np.cos(angles), 12.0)
    cloud[:, 0], cloud[:, 1], cloud[~near, 2] = r * np.cos(angles), r * np.sin(angles), np.inf
    grid = RollingMap(config.MappingConfig(input="cloud", range_m=4.0, inflation_m=0.0))
    grid.update_cloud(cloud, np.eye(4), se3(z_m=0.2))
    assert all(grid.state_at(1.52, y) == 100 for y in np.arange(-0.45, 0.5, 0.05))
    assert {grid.state_at(x, x * math.tan(a)) for x in (1.7, 3.0) for a in wall[3:-3]} == {-1}
    assert {grid.state_at(-x, x * math.tan(a)) for x in (1.7, 3.0) for a in wall} == {0}


@pytest.mark.parametrize("z_m", [0.1701, 0.2, 0.25, 0.3])
@pytest.mark.parametrize("behind_m", [2.5, math.inf])
def test_a_planar_lidar_clears_a_vanished_obstacle(z_m, behind_m):
    """A person stood there and left; behind is a wall, or nothing."""
    angles = np.radians(np.arange(360.0))

    def sweep(grid: RollingMap, r: np.ndarray) -> None:
        free = np.isinf(r)
        r = np.where(free, 3.0, r)
        rows = [r * np.cos(angles), r * np.sin(angles), np.where(free, np.inf, 0.0)]
        grid.update_cloud(np.stack(rows, axis=1).astype(F), np.eye(4), se3(z_m=z_m))

    grid = RollingMap(config.MappingConfig(input="cloud", range_m=4.0, inflation_m=0.0))
    sweep(grid, np.where(np.cos(angles) > 0.9, 1.52, behind_m))
    assert [grid.state_at(x, 0.0) for x in (1.0, 1.54, -2.0)] == [0, 100, 0]
    for _ in range(CLEAR_AFTER):
        sweep(grid, np.full(360, behind_m))
    assert [grid.state_at(x, 0.0) for x in (1.0, 1.54, -2.0)] == [0, 0, 0]
