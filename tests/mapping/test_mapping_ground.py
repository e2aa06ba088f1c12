"""The floor: on upper floors, under legged bodies, in lifts, tilted maps, on ramps, or nowhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mapping_twins import CAMERA, ORIGIN, SMALL, Box, render, room

from edge.geometry import SE2, se3, to_optical
from edge.mapping.grid import RollingMap
from edge.mapping.results import MapUpdate

BOX, WALLS = (1.7, -0.3, 0.0, 2.0, 0.3, 0.6), room(2.5)
ON_BOX, IN_FRONT, BY_WALL = (1.75, 0.0), (1.0, 0.0), (2.2, 1.2)
CAMERA_M = 0.6


def see(
    grid: RollingMap,
    boxes: list[Box],
    floor_z_m: float = 0.0,
    base_m: float = 0.0,
    pose: SE2 = ORIGIN,
    lean_rad: float = 0.0,
) -> MapUpdate:
    """Update with a camera 0.6 m over a floor at `floor_z_m` of `map`.

    Args:
        grid: map to update.
        boxes: obstacles of the world.
        pose: of the robot in `map`.
        floor_z_m: height of the floor in `map`.
        base_m: how high the base frame is over the floor.
        lean_rad: by how much the map is tilted, so that the floor falls along its x.
    """
    T_map_world = se3(z_m=floor_z_m, pitch_rad=lean_rad)
    T_world_base, T_base_camera = pose.matrix(base_m), camera(base_m)
    depth = render(CAMERA, T_world_base @ T_base_camera, boxes)
    return grid.update_depth(depth, CAMERA, T_map_world @ T_world_base, T_base_camera)


def camera(base_m: float = 0.0) -> np.ndarray:
    return to_optical(se3(0.1, 0.0, CAMERA_M - base_m, pitch_rad=math.radians(5)))


def states_of(grid: RollingMap, *places: tuple[float, float]) -> list[int]:
    return [grid.state_at(x, y) for x, y in places]


def test_without_returns_no_floor_is_known():
    update = RollingMap(SMALL).update_cloud(np.zeros((0, 3), np.float32), np.eye(4), np.eye(4))
    assert math.isnan(update.floor_z_m)
    assert not update.floor_seen


@pytest.mark.parametrize(
    ("floor_z_m", "base_m"),
    [
        (0.0, 0.0),
        (0.0, 0.8),
        (0.12, 0.1),
        (-0.12, 0.3),
        (-0.3, 0.5),
        (1.3, 0.3),
        (-3.0, 0.8),
        (80.0, 0.3),
    ],
)
def test_the_floor_is_found_at_any_height(floor_z_m, base_m):
    """An upper floor, a map whose z = 0 is the start of a base that is over the floor, and both."""
    grid = RollingMap(SMALL)
    for _ in range(2):
        update = see(grid, [BOX, *WALLS], floor_z_m, base_m)
    assert update.floor_seen
    assert update.floor_z_m == pytest.approx(floor_z_m, abs=0.03)
    assert states_of(grid, ON_BOX, IN_FRONT, BY_WALL, (2.52, 1.2)) == [100, 0, 0, 100]


TABLE, BED = (0.3, -2.0, 0.41, 2.4, 2.0, 0.45), (0.75, -2.0, 0.0, 2.4, 2.0, 0.5)
LOW_BED = (0.9, -0.5, 0.0, 2.4, 0.5, 0.35)


@pytest.mark.parametrize(
    ("obj", "base_m", "seen"),
    [(TABLE, 0.0, False), (BED, 0.0, False), (LOW_BED, 0.3, True), (LOW_BED, 0.4, True)],
    ids=["only a table", "only a bed", "bed as high as the base", "bed below the base"],
)
def test_furniture_at_the_start_is_not_taken_for_floor(obj, base_m, seen):
    """The floor is the lowest wide surface; it stays unknown until it is seen."""
    grid, floor_z_m = RollingMap(SMALL), 2.0
    for _ in range(3):
        update = see(grid, [obj, *WALLS], floor_z_m, base_m)
    assert (update.floor_seen, update.floor_missing) == (seen, False)
    assert grid.state_at(obj[0] + 0.08, 0.0) == 100
    for yaw in np.arange(0.4, 2 * math.pi, 0.4):
        update = see(grid, [obj, *WALLS], floor_z_m, base_m, SE2(0.0, 0.0, yaw))
    assert update.floor_z_m == pytest.approx(floor_z_m, abs=0.03)
    assert states_of(grid, (obj[0] + 0.08, 0.0), (-1.0, 0.0)) == [100, 0]


@pytest.mark.parametrize(
    "heights",
    [
        [(0.02 * k, 0.02 * k) for k in range(60)],
        [(0.0, 0.0)] * 3 + [(0.8, 0.8)] * 3,
        [(0.0, 0.3)] * 3 + [(0.0, 0.1)] * 3 + [(0.0, 0.3)] * 3,
        [(0.0, 0.3 + 0.03 * math.sin(k)) for k in range(30)],
    ],
    ids=["a lift", "a jump", "lying down and up", "trotting"],
)
def test_the_floor_follows_a_robot_that_moves_up_and_down(heights):
    """(floor, base) in `map` of each update."""
    grid = RollingMap(SMALL)
    for floor_z_m, base_z_m in heights:
        update = see(grid, [BOX, *WALLS], floor_z_m, base_z_m - floor_z_m)
        assert update.floor_z_m == pytest.approx(floor_z_m, abs=0.06)
        assert states_of(grid, ON_BOX, IN_FRONT, BY_WALL) == [100, 0, 0]


@pytest.mark.parametrize(("lean_deg", "base_m"), [(-3.0, 0.4), (3.0, 0.0)])
def test_the_floor_of_a_tilted_map_is_floor(lean_deg, base_m):
    grid = RollingMap(SMALL.model_copy(update={"extent_m": 30.0, "inflation_m": 0.0}))
    box = (8.0, -0.3, 0.0, 8.3, 0.3, 0.5)
    for x in np.arange(0.0, 6.0, 0.05):
        see(grid, [box], 1.0, base_m, SE2(x, 0.0, 0.0), math.radians(lean_deg))
    occupied = np.argwhere(grid.snapshot().cells == 100)
    x_m = (occupied[:, 1] + 0.5) * 0.05 + grid.snapshot().origin_xy_m[0]
    assert occupied.size
    assert (np.abs(x_m - 8.15) < 0.4).all()


@pytest.mark.parametrize("floor_z_m", [-1.2, -2.5])
def test_ground_far_below_the_base_is_not_free(floor_z_m):
    """A mount that is wrong by a metre, or a robot on a gallery: no guess is published."""
    grid = RollingMap(SMALL)
    T = camera()
    low = T.copy()
    low[2, 3] -= floor_z_m
    for _ in range(3):
        update = grid.update_depth(render(CAMERA, low, WALLS), CAMERA, np.eye(4), T)
    assert (update.floor_seen, update.floor_missing) == (False, True)
    assert states_of(grid, (0.0, 0.0), (1.0, 0.0), (2.0, 0.5)) == [0, -1, -1]


@pytest.mark.parametrize("z_m", [-0.3, -0.05, 0.05, 0.4])
def test_a_scan_without_floor_still_shows_walls(z_m):
    """A level LiDAR of one ring; the base of a legged robot may be over it."""
    grid = RollingMap(SMALL)
    angle = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    r = 2.0 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    cloud = np.stack([r * np.cos(angle), r * np.sin(angle), 0 * r], axis=1).astype(np.float32)
    update = grid.update_cloud(cloud, SE2(0.0, 0.0, 0.0).matrix(0.3), se3(z_m=z_m))
    assert not update.floor_seen
    assert states_of(grid, (1.0, 0.0), (0.0, -1.5), (2.02, 0.0), (0.0, 2.02)) == [0, 0, 100, 100]


def lidar(ground, boxes: list[Box], blind_m: float = 3.0) -> RollingMap:
    """Return the map of a 64-ring LiDAR 1.7 m over z = ground(x, y), blind in `blind_m`.

    The ground is a plane through the origin.
    """
    azimuth, down = np.meshgrid(
        np.linspace(-math.pi, math.pi, 1440, endpoint=False), np.radians(np.linspace(-25, 2, 64))
    )
    ray = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(down)], axis=-1).reshape(-1, 3)
    origin = np.array([0.0, 0.0, 1.7])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = 1.7 / (ground(ray[:, 0], ray[:, 1]) - ray[:, 2])
        t = np.where((t > 0.5) & (t < 25.0), t, np.inf)
        for box in boxes:
            a, b = (np.array(box[:3]) - origin) / ray, (np.array(box[3:]) - origin) / ray
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            t = np.where((enter <= leave) & (enter > 0), np.minimum(t, enter), t)
        cloud = (t[:, None] * ray)[np.isfinite(t)].astype(np.float32)
    grid = RollingMap(
        SMALL.model_copy(
            update={"input": "cloud", "resolution_m": 0.2, "extent_m": 60.0, "range_m": 20.0,
                    "inflation_m": 0.0, "min_range_m": blind_m}
        )
    )  # fmt: skip
    grid.update_cloud(cloud, np.eye(4), se3(z_m=1.7))
    return grid


CLIMBS = {
    "level": lambda x, y: 0.0 * x,
    "climbs": lambda x, y: 0.07 * x,
    "falls": lambda x, y: -0.07 * x,
    "leans": lambda x, y: 0.05 * y - 0.03 * x,
}


@pytest.mark.parametrize("road", CLIMBS.values(), ids=CLIMBS)
def test_a_road_that_climbs_in_the_blind_zone_is_ground(road):
    grid = lidar(road, [])
    cells = grid.snapshot().cells
    assert not (cells == 100).any()
    assert np.count_nonzero(cells == 0) * 0.04 > 0.9 * math.pi * 12.0**2


@pytest.mark.parametrize(("obj", "climb"), [("box", "leans"), ("box", "falls"), ("curb", "climbs")])
def test_a_low_obstacle_outside_the_blind_zone_is_occupied(obj, climb):
    """A box in a few sectors, and a curb as long as the road: all the rest agrees on the ground."""
    road = CLIMBS[climb]
    x, y = (4.2, 0.0) if obj == "box" else (0.0, 4.2)
    z = float(road(x, y))
    size = (0.4, 0.6) if obj == "box" else (12.0, 0.3)
    low = (x - size[0] / 2, y - size[1] / 2, z - 0.9, x + size[0] / 2, y + size[1] / 2, z + 0.2)
    grid = lidar(road, [low])
    occupied = np.argwhere(grid.snapshot().cells == 100)
    at_m = (occupied[:, ::-1] + 0.5) * 0.2 + np.array(grid.snapshot().origin_xy_m)
    near = np.abs(at_m - (x, y)) <= np.array(size) / 2 + 0.3
    assert np.count_nonzero(near.all(axis=1)) >= 2
    if obj == "box":
        assert near.all()


def unseen(grid: RollingMap, obj: Box, others: list[Box], lost: float = np.nan) -> None:
    """Three looks at a scene in which one object gives no return."""
    T = camera()
    there, without = (render(CAMERA, T, boxes) for boxes in ([obj, *others], others))
    depth = np.where(np.abs(there - without) > 1e-3, np.float32(lost), there)
    for _ in range(3):
        grid.update_depth(depth, CAMERA, np.eye(4), T)


@pytest.mark.parametrize(
    ("x_m", "high_m", "lost"),
    [
        (1.3, 0.25, np.nan),
        (2.1, 0.25, 0.0),
        (1.8, 0.4, np.inf),
        (1.3, 0.9, 0.0),
        (2.1, 0.9, np.nan),
    ],
)
def test_an_object_without_returns_is_not_free(x_m, high_m, lost):
    """Black, or glass: the rays that pass over it are as high as it is at least."""
    grid = RollingMap(SMALL.model_copy(update={"inflation_m": 0.0}))
    unseen(grid, (x_m, -0.3, 0.0, x_m + 0.3, 0.3, high_m), WALLS, lost)
    assert states_of(grid, *((x_m + 0.1, y) for y in (-0.2, 0.0, 0.2))) == [-1, -1, -1]
    assert states_of(grid, (1.0, 0.0), (0.3, 0.0), (2.0, 1.0)) == [0, 0, 0]


def test_holes_in_the_image_hide_no_floor():
    """A tenth of the pixels, and all within a metre of the camera, as many have it."""
    grid = RollingMap(SMALL.model_copy(update={"inflation_m": 0.0}))
    rng, T = np.random.default_rng(0), camera()
    across = (np.arange(CAMERA.width_px) - CAMERA.cx_px) / CAMERA.fx_px
    for _ in range(3):
        depth = render(CAMERA, T, WALLS)
        near = depth * np.hypot(1.0, across) < 1.0
        depth[(rng.random(depth.shape) < 0.1) | near] = 0.0
        grid.update_depth(depth, CAMERA, np.eye(4), T)
    x, y = np.meshgrid(np.arange(0.0, 2.4, 0.05), np.arange(-0.5, 0.5, 0.05))
    ahead = np.abs(y) < 0.6 * (x - 0.1)
    assert set(states_of(grid, *zip(x[ahead], y[ahead], strict=True))) == {0}


def test_rays_over_the_robot_free_nothing():
    """A camera that looks up sees a wall over the heads of all that may stand before it."""
    grid = RollingMap(SMALL.model_copy(update={"inflation_m": 0.0}))
    T = to_optical(se3(0.1, 0.0, CAMERA_M, pitch_rad=math.radians(-50)))
    for _ in range(3):
        grid.update_depth(render(CAMERA, T, WALLS, floor=False), CAMERA, np.eye(4), T)
    assert states_of(grid, (0.6, 0.0), (2.2, 0.0)) == [0, -1]
