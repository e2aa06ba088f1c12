"""Value maps against ViTL's and VLFM's equations in plain NumPy, by hand, and over rolls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapping_twins import CAMERA, SMALL, T_BASE_CAMERA, look, render, room, seen_around

from edge.geometry import SE2, CameraModel, optical_yaw_rad
from edge.mapping.grid import RollingMap
from edge.mapping.layers import make_layers
from edge.mapping.values import RAYS, ROWS, UNIT, RangeProfile, ValueMap, fuse
from edge.mapping.window import Window
from edge.types import Observation

FOV = math.radians(75)
HALF_STEP = 0.51 / UNIT
BETA = 0.5


def value_map(targets=("bed",), n: int = 192, range_m: float = 3.0, origin=(-64, -64)) -> ValueMap:
    """On an empty map of 0.05 m cells; its own cells have 0.2 m."""
    window = Window(n, 0.05)
    window.origin, window.placed = origin, True
    values = ValueMap(make_layers(n), window, 0.2, range_m, BETA)
    values.set_targets(targets)
    return values


def window_of(values: ValueMap) -> Window:
    return values._window


def sight(x=0.0, y=0.0, yaw=0.0, range_m=3.0, fov=FOV) -> RangeProfile:
    """One that sees equally far everywhere, or as far as an array says."""
    return RangeProfile(x, y, yaw, fov, np.broadcast_to(np.float32(range_m), RAYS).copy())


def centres(values: ValueMap) -> tuple[np.ndarray, np.ndarray]:
    """(m, m) x and y in metres of the cells, by storage row and column."""
    m, (ox, oy) = len(values.value), (v // 4 for v in window_of(values).origin)
    xs = ox + (np.arange(m) - ox) % m
    ys = oy + (np.arange(m) - oy) % m
    return np.meshgrid((xs + 0.5) * 0.2, (ys + 0.5) * 0.2)


def in_view(values: ValueMap, seen: RangeProfile) -> tuple[np.ndarray, np.ndarray]:
    """(m, m) bool: whether a cell's centre is in view; (m, m) its bearing. Twin of `seen_cells`."""
    x, y = centres(values)
    bearing = np.arctan2(y - seen.y_m, x - seen.x_m) - seen.yaw_rad
    bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
    ray = np.floor((bearing / seen.fov_rad + 0.5) * RAYS).astype(int)
    inside = (ray >= 0) & (ray < RAYS)
    reach = seen.range_m[np.clip(ray, 0, RAYS - 1)].astype(np.float64)
    away = np.hypot(x - seen.x_m, y - seen.y_m)
    return inside & (reach > 0) & (away <= reach + 0.1), bearing


def unpacked(values: ValueMap, channel: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return values.value[..., channel] / UNIT, values.weight[..., channel] / UNIT


# -- nothing, and channels -----------------------------------------------------------------


def test_without_targets_nothing_is_written_or_read():
    values = value_map(targets=())
    values.write_view(sight(), ("bed",), np.ones(1, np.float32))
    values.write_directions(sight(), "bed", np.ones((1, 2)), np.ones(1), 1.0)
    values.roll(0, 64)
    with pytest.raises(IndexError, match="value channel 0: the map has 0"):
        values.best(0, np.zeros((1, 2), np.float32), 1, 0.5, np.zeros(1, np.float32))


def test_a_window_that_has_no_place_takes_nothing():
    values = value_map()
    window_of(values).placed = False
    values.write_view(sight(), ("bed",), np.ones(1, np.float32))
    assert not values.weight.any()


def test_remaining_targets_keep_their_values_when_targets_change():
    values = value_map(("bed", "sofa"))
    values.write_view(sight(), ("bed", "sofa", "lamp"), np.array([0.2, 0.6, 1.0], np.float32))
    sofa = unpacked(values, 1)
    values.set_targets(("lamp", "sofa"))
    assert not values.weight[..., 0].any()
    np.testing.assert_array_equal(unpacked(values, 1), sofa)
    assert sofa[0].max() == pytest.approx(0.6, abs=HALF_STEP)


# -- ViTL's writer -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "current", "expected"),
    [
        ((0.0, 0.0), (0.3, 0.6), 0.3),  # never observed
        ((0.4, 0.8), (0.3, 0.6), 0.3),  # both say 1/2
        ((0.72, 0.9), (0.02, 0.1), 0.074),  # a dull view hardly counts: 0.74 of a scene of 0.1
        ((0.01, 0.1), (0.72, 0.9), 0.657),
        ((0.5, 0.5), (0.0, 0.0), 0.0),  # a hopeless view
        ((1.0, 1.0), (1.0, 1.0), 1.0),
    ],
)
def test_temporal_fusion_is_eq_7(old, current, expected):
    assert fuse(*old, *current) == pytest.approx(expected)


def directions_twin(values, seen, xy, p, scene, channel=0):
    """Eq. 6 to 8: the values and weights after a write."""
    value, weight = (layer.copy() for layer in unpacked(values, channel))
    half, m = seen.fov_rad / 2, len(value)
    points = [(-half, BETA * scene), (half, BETA * scene)]
    for (x, y), share in zip(xy, p, strict=True):
        bearing = math.atan2(y - seen.y_m, x - seen.x_m) - seen.yaw_rad
        bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
        at = math.floor(y / 0.2) % m, math.floor(x / 0.2) % m
        fused = current = scene * share
        if weight[at] > 0:
            fused = (value[at] + current) / (weight[at] + scene) * scene
        if abs(bearing) <= half:
            points.append((bearing, fused))
    angles, scores = np.array(sorted(points)).T
    inside, bearing = in_view(values, seen)
    value[inside] = np.interp(bearing[inside], angles, scores)
    weight[inside] = scene
    return value, weight


@given(seed=st.integers(0, 10**6), frontiers=st.integers(0, 8))
def test_directional_scores_are_spread_as_eq_8(seed, frontiers):
    rng = np.random.default_rng(seed)
    values = value_map(("bed", "sofa"), origin=tuple(64 * rng.integers(-9, 9, 2)))
    middle = (np.array(window_of(values).origin) + 96) * 0.05
    for _ in range(3):
        x, y = middle + rng.uniform(-1, 1, 2)
        # Unlike ranges make every occlusion; a little slack keeps cells off the very rim.
        seen = sight(x, y, rng.uniform(-3, 3), rng.choice([0.0, 1.013, 2.017, 2.911], RAYS))
        xy = np.array([x, y]) + rng.uniform(-2, 2, (frontiers, 2))
        p = rng.dirichlet(np.ones(frontiers + 1))[:frontiers]
        scene = float(rng.uniform(0.05, 1.0))
        value, weight = directions_twin(values, seen, xy, p, scene, 1)
        values.write_directions(seen, "sofa", xy, p, scene)
        got = unpacked(values, 1)
        np.testing.assert_allclose(got[0], value, atol=3e-4)  # angles of cells are float32
        np.testing.assert_allclose(got[1], weight, atol=HALF_STEP)
        assert (values.value <= values.weight).all()
    assert not values.weight[..., 0].any()


def test_figure_3_by_hand():
    """Frontiers A left and B right, beta 0.5, S = 0.8, P = 0.6 and 0.1."""
    values, seen = value_map(), sight(0.1, 0.1)  # in the middle of a cell
    a, b = ((0.1 + 2 * math.cos(t), 0.1 + 2 * math.sin(t)) for t in (0.3, -0.3))
    values.write_directions(seen, "bed", np.array([a, b]), np.array([0.6, 0.1]), 0.8)
    out = np.zeros(4, np.float32)
    ahead, behind = (1.5, 0.1), (-1.0, 0.1)
    values.best(0, np.array([a, b, ahead, behind], np.float32), 4, 0.05, out)
    assert out[:2] == pytest.approx([0.48, 0.08], abs=0.03)  # V = S P where the frontiers are
    # Between them it changes linearly with the bearing: in the middle is the mean.
    assert out[2] == pytest.approx(0.28, abs=HALF_STEP)
    assert np.isnan(out[3])
    inside, bearing = in_view(values, seen)
    rim = inside & (np.abs(bearing) > FOV / 2 - 0.03)
    assert rim.any()
    assert unpacked(values)[0][rim] == pytest.approx(0.4, abs=0.03)  # beta S at the edges


# -- VLFM's writer -------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6))
def test_whole_view_scores_are_blended_as_vlfm_does(seed):
    rng = np.random.default_rng(seed)
    values = value_map(("bed", "sofa"))
    value, weight = np.zeros_like(unpacked(values)[0]), np.zeros_like(unpacked(values)[1])
    for _ in range(3):
        x, y = 1.6 + rng.uniform(-1, 1, 2)
        seen = sight(x, y, rng.uniform(-3, 3), rng.choice([0.0, 1.013, 2.017, 2.911], RAYS))
        score = rng.uniform(0, 1, 2).astype(np.float32)
        inside, bearing = in_view(values, seen)
        c = np.cos(bearing / (FOV / 2) * math.pi / 2) ** 2 * inside
        c[c * UNIT < 0.5] = 0.0
        total = np.where(c > 0, c + weight, 1.0)
        value = np.where(c > 0, (weight * value + c * float(score[1])) / total, value)
        weight = np.where(c > 0, (weight**2 + c**2) / total, weight)
        # The targets may come in any order.
        values.write_view(seen, ("sofa", "bed"), score[::-1])
    got = unpacked(values, 1)
    np.testing.assert_allclose(got[1], weight, atol=4 * HALF_STEP)
    settled = weight > 0.01  # below that the rounding of the weights shows
    np.testing.assert_allclose(got[0][settled], value[settled], atol=2e-3)


# -- views of an observation ----------------------------------------------------------------


def observed(pose: SE2, depth, camera: CameraModel = CAMERA) -> Observation:
    return Observation(
        0, 0, pose.matrix(), depth_m=depth, camera=camera, T_base_camera=T_BASE_CAMERA
    )


def test_no_camera_sees_nothing_and_no_place_neither():
    values = value_map()
    assert values.range_profile(Observation(0, 0, np.eye(4))) is None
    lost = SE2(0, 0, 0).matrix()
    lost[0, 3] = np.nan
    assert values.range_profile(Observation(0, 0, lost, camera=CAMERA)) is None


@given(seed=st.integers(0, 10**6))
def test_the_range_profile_holds_the_farthest_return_per_column(seed):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.3, 4.0, (CAMERA.height_px, CAMERA.width_px)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.3] = rng.choice([np.nan, 0.0, np.inf, -1.0, 2e6])
    depth[:, rng.random(CAMERA.width_px) < 0.2] = np.nan
    pose = SE2(0.5, -0.2, rng.uniform(-3, 3))
    seen = value_map().range_profile(observed(pose, depth))
    T = pose.matrix() @ T_BASE_CAMERA
    v, u = np.indices(depth.shape)
    v_step = max(1, CAMERA.height_px // ROWS)
    rays = np.stack(
        [(u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px, np.ones(u.shape)], -1
    )
    with np.errstate(invalid="ignore"):
        plane = np.hypot(*np.moveaxis((rays * depth[..., None]) @ T[:2, :3].T, -1, 0))
        plane[~((depth > 0) & (depth < 1e6))] = 0.0
    for k in range(RAYS):
        bearing = ((k + 0.5) / RAYS - 0.5) * seen.fov_rad
        column = CAMERA.cx_px - CAMERA.fx_px * math.tan(bearing) / math.hypot(*T[:2, 2])
        column = min(max(math.floor(column + 0.5), 0), CAMERA.width_px - 1)
        farthest = min(plane[::v_step, column].max(), 3.0)
        assert seen.range_m[k] == pytest.approx(farthest, rel=1e-4)
    assert seen.yaw_rad == pytest.approx(optical_yaw_rad(T))


PILLAR = (1.0, -0.3, 0.0, 1.2, 0.3, 2.0)


@pytest.mark.parametrize("by_depth", [True, False])
def test_values_are_not_written_behind_obstacles(by_depth):
    """By the depth image, and for a robot with a LiDAR and a camera alone by the map."""
    for boxes, hidden in ((room(2.5), False), ([*room(2.5), PILLAR], True)):
        grid = seen_around(boxes)
        look(grid, SE2(0.0, 0.0, 0.0), boxes)
        T = T_BASE_CAMERA.copy()
        depth = render(CAMERA, T, boxes) if by_depth else None
        grid.values.set_targets(("bed",))
        seen = grid.values.range_profile(observed(SE2(0.0, 0.0, 0.0), depth))
        grid.values.write_view(seen, ("bed",), np.ones(1, np.float32))
        out = np.zeros(3, np.float32)
        places = np.array([[1.9, 0.05], [0.7, 0.05], [3.1, 0.0]], np.float32)
        grid.values.best(0, places, 3, 0.05, out)
        assert np.isnan(out[0]) == hidden
        assert out[1] == pytest.approx(1.0, abs=HALF_STEP)
        assert np.isnan(out[2])  # behind the wall


# -- reading and rolling -------------------------------------------------------------------


@given(seed=st.integers(0, 10**6), radius=st.floats(0.0, 1.3))
def test_the_best_near_a_place_is_eq_9(seed, radius):
    rng = np.random.default_rng(seed)
    values = value_map(("bed", "sofa"), n=64, origin=tuple(64 * rng.integers(-3, 3, 2)))
    values.value[:] = rng.integers(0, UNIT, values.value.shape)
    values.weight[:] = rng.random(values.weight.shape) < 0.1
    middle = (np.array(window_of(values).origin) + 32) * 0.05
    xy = (middle + rng.uniform(-2.2, 2.2, (20, 2))).astype(np.float32)
    out = np.zeros(20, np.float32)
    values.best(1, xy, 20, radius, out)
    x, y = centres(values)
    value, weight = unpacked(values, 1)
    for place, got in zip(xy.astype(np.float64), out, strict=True):
        away = np.hypot(x - place[0], y - place[1])
        if np.abs(away - radius).min() < 1e-5:
            continue  # a cell on the very rim may fall to either side
        own = (np.floor(x / 0.2) == np.floor(place[0] / 0.2)) & (
            np.floor(y / 0.2) == np.floor(place[1] / 0.2)
        )
        near = ((away <= radius) | own) & (weight > 0)
        expected = value[near].max() if near.any() else np.nan
        np.testing.assert_allclose(got, expected, atol=1e-6)


@given(
    moves=st.lists(st.tuples(st.integers(0, 1), st.integers(-4, 4)), max_size=6),
    seed=st.integers(0, 10**6),
)
def test_rolling_clears_only_cells_that_leave_the_window(moves, seed):
    rng = np.random.default_rng(seed)
    values = value_map(("bed",))
    m = len(values.value)
    values.value[..., 0] = rng.integers(1, UNIT, (m, m))
    values.weight[:] = 1
    x, y = (np.round(c / 0.2 - 0.5).astype(int) for c in centres(values))
    known = dict(zip(zip(x.ravel(), y.ravel(), strict=True), values.value.ravel(), strict=True))
    for axis, cells in moves:
        values.roll(axis, 64 * cells)
        origin = list(window_of(values).origin)
        origin[axis] += 64 * cells
        window_of(values).origin = (origin[0], origin[1])
        x, y = (np.round(c / 0.2 - 0.5).astype(int) for c in centres(values))
        here = list(zip(x.ravel(), y.ravel(), strict=True))
        known = {cell: known[cell] for cell in here if cell in known}
        assert [int(v) for v in values.value.ravel()] == [known.get(cell, 0) for cell in here]


def test_values_roll_with_the_map():
    grid: RollingMap = seen_around(room(2.0))
    grid.values.set_targets(("bed",))
    seen = sight(fov=FOV, range_m=2.5)
    grid.values.write_view(seen, ("bed",), np.ones(1, np.float32))
    out, place = np.zeros(1, np.float32), np.array([[1.0, 0.0]], np.float32)
    grid.values.best(0, place, 1, 0.2, out)
    assert out[0] == pytest.approx(1.0, abs=HALF_STEP)
    far = SMALL.extent_m * 3
    look(grid, SE2(far, 0.0, 0.0), [])
    grid.values.best(0, place, 1, 0.2, out)
    assert np.isnan(out[0])
    look(grid, SE2(0.0, 0.0, 0.0), [])
    grid.values.best(0, place, 1, 0.2, out)
    assert np.isnan(out[0])  # forgotten, not only out of sight


def test_a_snapshot_without_values_is_empty():
    assert value_map(()).snapshot("bed").cells.shape == value_map().snapshot("bed").cells.shape
    assert value_map().snapshot("bed").cells.shape == (0, 0)


@pytest.mark.parametrize("origin", [(-64, -64), (0, -128), (64, 320)])
def test_a_snapshot_has_the_positions_of_its_cells(origin):
    values = value_map(("bed", "tv"), origin=origin)
    seen = sight(*((o + 96) * 0.05 for o in origin), yaw=1.0, range_m=2.0)
    values.write_view(seen, ("tv",), np.array([0.5]))
    assert values.snapshot("bed").cells.size == 0
    grid = values.snapshot("tv")
    x, y = centres(values)
    rows, columns = np.nonzero(grid.cells)
    places = np.round(grid.centres_m(rows, columns), 6)
    weighty = values.weight[..., 1] > 0
    assert {*map(tuple, places)} == {*zip(x[weighty].round(6), y[weighty].round(6), strict=True)}
    assert set(np.unique(grid.cells)) - {0} == {128}, "half of 254, and 1"
