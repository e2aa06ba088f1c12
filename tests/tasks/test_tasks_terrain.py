from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import LIDAR, Box, street

from edge.geometry import SE2, Grid
from edge.tasks.scene import terrain
from edge.tasks.scene.terrain import (
    CELL_M,
    SLOPE,
    STEP_M,
    GroundHeight,
    height_above,
    regions_of,
    with_blind_spot,
)

NOWHERE = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.2)
HERE = SE2(0.0, 0.0, 0.0)


def grid(rows, resolution_m=0.5):
    """Return a grid from text: # occupied, . free, ? unknown.

    The first line is farthest to the left of the robot (largest y). The middle of the first row
    and column is (0, 0).
    """
    table = {"#": 100, ".": 0, "?": -1}
    cells = np.array([[table[c] for c in row] for row in reversed(rows)], np.int8)
    return Grid(cells, (-resolution_m / 2, -resolution_m / 2), resolution_m)


def around(observation, z_m=0.0):
    T = observation.T_map_base @ LIDAR
    points = (observation.cloud_m @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    pose = observation.pose
    return terrain.estimate_ground(points, pose.x_m, pose.y_m, z_m, 40.0), points


def test_no_points_no_ground():
    ground = terrain.estimate_ground(np.zeros((0, 3), np.float32), 1.0, -2.0, 0.3, 5.0)
    assert ground.seen.cells.sum() == 1  # where the robot stands
    assert (ground.height_m.cells == np.float32(0.3)).all()
    assert height_above(ground, np.zeros((0, 3), np.float32)).shape == (0,)


def test_points_on_objects_are_above_the_ground():
    observation, hit = street([Box(10.0, 2.0), Box(15.0, -4.0, (8.0, 3.0, 4.0), 0.4)])
    ground, points = around(observation)
    above = height_above(ground, points)
    near = np.abs(points[:, :2]).max(axis=1) < 40.0
    # The foot of a box is ground as far up as ground may rise within a cell.
    np.testing.assert_allclose(above[near], points[near, 2], atol=STEP_M + SLOPE * CELL_M)
    np.testing.assert_allclose(above[near & (hit < 0)], 0.0, atol=1e-5)
    assert (above[near & (hit >= 0) & (points[:, 2] > 0.31)] > 0.15).all()


def test_a_ramp_is_ground_and_a_wall_is_not():
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 20, 0.2), np.arange(-3, 3, 0.2)))
    ramp = np.stack((x, y, 0.1 * x), axis=1)
    wall = np.stack((np.full(50, 12.1), np.linspace(-2.4, 2.4, 50), np.full(50, 1.8)), axis=1)
    ground = terrain.estimate_ground(
        np.vstack((ramp, wall)).astype(np.float32), 0.1, 0.0, 0.0, 25.0
    )
    above = height_above(ground, np.vstack((ramp, wall)).astype(np.float32))
    assert np.abs(above[: len(ramp)]).max() < 0.15
    assert (above[len(ramp) :] > 0.4).all()


def test_outside_and_without_number_nothing_is_known():
    ground = GroundHeight(
        Grid(np.zeros((2, 2), np.float32), (0, 0), 1.0), Grid(np.ones((2, 2)), (0, 0), 1)
    )
    points = np.array([[0.5, 0.5, 1.0], [-0.1, 0, 0], [0, 2.5, 0], [np.nan, 0, 0]], np.float32)
    np.testing.assert_array_equal(height_above(ground, points), [1.0, np.nan, np.nan, np.nan])


def test_no_map_has_no_blind_spot():
    assert with_blind_spot(NOWHERE, HERE) is NOWHERE


def blind(*walls, free_m=(2.5, 6.0), wedge_rad=np.pi):
    """Return a robot in the middle of 16 m by 16 m with partly unknown ground.

    0.4 m around it are free, and the ground between two distances within an angle of ahead. Walls
    are (x0, x1, y0, y1).
    """
    grid_ = Grid(np.full((80, 80), -1, np.int8), (-8.0, -8.0), 0.2)
    x, y = np.moveaxis(grid_.centres_m(*np.indices((80, 80))), -1, 0)
    away, angle = np.hypot(x, y), np.abs(np.arctan2(y, x))
    seen = (away > free_m[0]) & (away < free_m[1]) & (angle < wedge_rad)
    grid_.cells[seen | (away < 0.4)] = 0
    for x0, x1, y0, y1 in walls:
        grid_.cells[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = 100
    return grid_, away, angle


def test_ground_up_to_the_first_return_is_free():
    occupancy, away, _ = blind()
    got = with_blind_spot(occupancy, HERE).cells
    assert (got[away < 6.0] == 0).all()
    np.testing.assert_array_equal(got[away > 6.0], occupancy.cells[away > 6.0])


def test_unseen_ground_stays_unknown():
    """A depth camera does not see to the side or behind."""
    occupancy, away, angle = blind(wedge_rad=0.5)
    got = with_blind_spot(occupancy, HERE).cells
    assert (got[(angle < 0.4) & (away < 2.5)] == 0).all()
    outside = (angle > 0.7) & (away > 1.0)
    assert (got[outside] == -1).all()


def test_ground_before_a_wall_stays_unknown():
    occupancy, away, angle = blind((1.5, 2.0, -8.0, 8.0))
    got = with_blind_spot(occupancy, HERE).cells
    assert (got[(angle < 0.5) & (away < 1.6) & (away > 0.6)] == -1).all()
    assert (got[(angle > 2.0) & (away < 2.5)] == 0).all()


def test_ground_that_the_robot_has_left_is_not_blind():
    """It stands on a region already: the unknown cells there were visible to no sensor."""
    occupancy, _, _ = blind((1.0, 1.4, -0.4, 0.4), free_m=(0.0, 6.0))
    occupancy.cells[38:42, 48:50] = -1
    assert with_blind_spot(occupancy, HERE) is occupancy


def kinds(occupancy, xy_m, kind, pose=HERE, n=2):
    return terrain.classify_ground(
        occupancy, pose, np.array(xy_m, np.float64).reshape(-1, 2), np.array(kind, np.int64), n
    )


def test_no_cells_and_no_points_have_no_kind():
    assert kinds(NOWHERE, [], []).shape == (0, 0)
    assert not kinds(grid(["..."]), [], []).any()


def test_cells_are_of_the_kind_of_most_of_their_points():
    far = SE2(-100.0, 0.0, 0.0)
    row = grid(["....??" + "?" * 30])
    got = kinds(row, [[0, 0], [0.1, 0], [-0.1, 0], [1.5, 0]], [1, 2, 2, 1], far)[0]
    assert got[:4].tolist() == [2, 2, 1, 1], "between scan lines: the nearest"
    assert not got[4:].any(), "unknown ground has none"


def test_the_blind_spot_takes_the_kind_of_its_rim():
    row = grid(["." * 20])
    got = kinds(row, [[0.5 * i, 0] for i in range(11, 20)], [2] + [1] * 8, SE2(1.0, 0, 0))
    assert (got[0, :11] == 2).all()


def test_regions_are_numbered_by_size_and_cover_their_kind():
    occupancy = grid(["........"] * 3 + ["########"] + ["........"] * 4, 1.0)
    kind = np.ones((8, 8), np.uint8)
    kind[:, 6:] = 2
    regions, cells = regions_of(occupancy, kind, ["road", "sidewalk"])
    assert [(r.label, r.area_m2) for r in regions.values()] == [
        ("road", 24.0), ("road", 18.0), ("sidewalk", 8.0), ("sidewalk", 6.0),
    ]  # fmt: skip
    assert list(regions) == [1, 2, 3, 4]
    for i, region in regions.items():
        assert (cells.cells == i).sum() == region.area_m2
        assert set(kind[cells.cells == i]) == {["road", "sidewalk"].index(region.label) + 1}
    assert not cells.cells[occupancy.cells == 100].any()


def test_small_pieces_are_not_regions():
    kind = np.array([[1, 0, 0, 1, 1, 1]], np.uint8)
    regions, _ = regions_of(grid(["......"], 1.0), kind, ["road"])
    assert [r.area_m2 for r in regions.values()] == [3.0]


def test_a_small_piece_joins_its_neighbour():
    kind = np.array([[1, 1, 1, 2, 2, 1, 1, 1, 0, 2]], np.uint8)
    regions, cells = regions_of(grid(["." * 10], 1.0), kind, ["lawn", "sidewalk"])
    assert [(r.label, r.area_m2) for r in regions.values()] == [("lawn", 4.0), ("lawn", 4.0)]
    assert cells.cells[0].tolist() == [1, 1, 1, 1, 2, 2, 2, 2, 0, 0]


def nearest_twin(points, regions, allowed):
    out = {}
    for i in np.unique(regions.cells[regions.cells > 0]):
        rows, columns = np.nonzero((regions.cells == i) & allowed)
        if len(rows):
            middles = regions.centres_m(rows, columns)
            cells = np.floor(regions.to_cells(points[:, :2])) + 0.5
            d = np.linalg.norm(middles[:, None] - regions.to_metres(cells)[None], axis=2).min(1)
            out[int(i)] = d.min()
    return out


@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_points_agree_with_their_twin(seed):
    random = np.random.default_rng(seed)
    regions = Grid(random.integers(0, 4, (9, 12)).astype(np.uint8), (-1.0, 2.0), 0.5)
    allowed = random.random((9, 12)) < 0.5
    points = random.uniform(-4, 8, (5, 3))
    got = terrain.nearest_points(points, regions, allowed)
    expected = nearest_twin(points, regions, allowed)
    assert set(got) == set(expected)
    cells = regions.to_metres(np.floor(regions.to_cells(points[:, :2])) + 0.5)
    for i, (x_m, y_m) in got.items():
        row, column = regions.cell_of(x_m, y_m)
        assert regions.cells[row, column] == i
        assert allowed[row, column]
        assert np.linalg.norm(cells - (x_m, y_m), axis=1).min() == pytest.approx(expected[i])


def test_no_points_no_nearest():
    regions = Grid(np.ones((2, 2), np.uint8), (0, 0), 1.0)
    assert terrain.nearest_points(np.zeros((0, 3)), regions, np.ones((2, 2), np.bool_)) == {}


@given(seed=st.integers(0, 2**32 - 1))
def test_ground_agrees_with_its_twins(seed):
    random = np.random.default_rng(seed)
    points = random.uniform((-4, -4, -0.3), (4, 4, 0.6), (60, 3)).astype(np.float32)
    points[random.random(60) < 0.1] = np.nan
    found = terrain.estimate_ground(points, 0.0, 0.0, 0.0, 3.0)
    ground, known = found.height_m.cells, found.seen.cells
    low = lowest_twin(points, -3.0, -3.0, known.shape)
    height_m, expected = known_twin(low, (6, 6), 0.0, round(terrain.GAP_M / CELL_M))
    np.testing.assert_array_equal(known, expected)
    np.testing.assert_array_equal(ground[known], height_m[known])
    assert np.isin(ground, ground[known]).all(), "filled with heights of ground"


def known_twin(low, robot, z_m, reach):
    """Return height and ground of each cell: a cell is ground if it continues other ground."""
    height_m = low.astype(np.float64)
    height_m[robot] = z_m
    at = np.stack(np.indices(low.shape), -1).reshape(-1, 2)
    apart = np.abs(at[:, None] - at)
    allowed_m = STEP_M + SLOPE * CELL_M * np.hypot(apart[..., 0], apart[..., 1])
    near, flat_m = apart.max(-1) <= reach, height_m.ravel()
    with np.errstate(invalid="ignore"):
        continues = near & (np.abs(flat_m[:, None] - flat_m) <= allowed_m)
    known = (at == robot).all(-1)
    for _ in at:
        known |= continues[:, known].any(1) & np.isfinite(flat_m)
    limit_m = np.where(near & known, np.where(known, flat_m, 0.0) + allowed_m, np.inf).min(1)
    return height_m, (known & (flat_m <= limit_m)).reshape(low.shape)


def lowest_twin(points, x0_m, y0_m, shape):
    out = np.full(shape, np.inf, np.float32)
    for x, y, z in points[np.isfinite(points).all(axis=1)]:
        c, r = (x - x0_m) / CELL_M, (y - y0_m) / CELL_M
        if 0 <= c < shape[1] and 0 <= r < shape[0]:
            out[int(r), int(c)] = min(out[int(r), int(c)], z)
    return out
