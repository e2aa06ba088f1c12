"""Real sensors: a PrimeSense in an office (Redwood), a Velodyne in traffic (SemanticKITTI)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge import config
from edge.geometry import CameraModel, invert, se2_of, se3
from edge.mapping.grid import RollingMap

# y is up in Redwood's world, and its floor is at 0.13 m.
T_MAP_REDWOOD = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, -0.13], [0, 0, 0, 1]], float)
CAR, MOVING_CAR, ROAD = 10, 252, 40


def redwood(folder: Path) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(depth in metres, T_map_camera) of each frame."""
    lines = (folder / "trajectory.log").read_text().splitlines()
    for i in range(5):
        depth = cv2.imread(str(folder / f"depth/{i:05d}.png"), cv2.IMREAD_UNCHANGED)
        T = np.array([[float(v) for v in line.split()] for line in lines[5 * i + 1 : 5 * i + 5]])
        yield depth.astype(np.float32) / 1000.0, T_MAP_REDWOOD @ T


def cell_counts(xy_m: np.ndarray, resolution_m: float) -> dict[tuple[int, int], int]:
    cells, counts = np.unique(np.floor(xy_m / resolution_m).astype(int), axis=0, return_counts=True)
    return {(int(x), int(y)): int(c) for (x, y), c in zip(cells, counts, strict=True)}


def share(grid: RollingMap, cells, state: int) -> float:
    r = grid.resolution_m
    return float(np.mean([grid.state_at((x + 0.5) * r, (y + 0.5) * r) == state for x, y in cells]))


def test_redwood_furniture_is_occupied_and_its_floor_free(shared_dir):
    camera = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
    grid = RollingMap(config.MappingConfig(inflation_m=0.0))
    v, u = np.mgrid[:480, :640]
    rays = np.stack([(u - 319.5) / 525, (v - 239.5) / 525, np.ones_like(u)], axis=-1)
    for depth, T in redwood(shared_dir / "logs/redwood_rgbd"):
        T_map_base = se2_of(T).matrix()
        grid.update_depth(depth, camera, T_map_base, invert(T_map_base) @ T)
        assert not (depth > 0).all(), "the sensor leaves holes"
        surface = (rays * depth[..., None])[depth > 0] @ T[:3, :3].T + T[:3, 3]
    z = surface[:, 2]
    solid = cell_counts(surface[(z > 0.2) & (z < 0.9), :2], 0.05)
    anything = cell_counts(surface[z > 0.06, :2], 0.05)
    floor = cell_counts(surface[z < 0.04, :2], 0.05)
    solid_cells = [c for c, n in solid.items() if n >= 50]
    around = {(x + i, y + j) for x, y in anything for i in (-1, 0, 1) for j in (-1, 0, 1)}
    floor_cells = [c for c, n in floor.items() if n >= 20 and c not in around]
    assert len(solid_cells) > 100
    assert len(floor_cells) > 20
    assert share(grid, solid_cells, 100) > 0.97
    assert share(grid, floor_cells, 0) > 0.97


@pytest.mark.parametrize("frame", [0, 2, 4, 6, 8])
def test_kitti_cars_are_occupied_and_the_road_is_free(shared_dir, frame):
    folder = shared_dir / "logs/semantic_kitti_05"
    scan = np.fromfile(folder / f"velodyne/{frame:06d}.bin", np.float32).reshape(-1, 4)
    label = np.fromfile(folder / f"labels/{frame:06d}.label", np.uint32) & 0xFFFF
    cloud = np.ascontiguousarray(scan[:, :3])
    grid = RollingMap(
        config.MappingConfig(
            input="cloud",
            resolution_m=0.2,
            extent_m=60.0,
            range_m=20.0,
            inflation_m=0.0,
            min_range_m=2.5,
            obstacle_min_m=0.3,
            obstacle_max_m=2.0,
        )
    )
    grid.update_cloud(cloud, np.eye(4), se3(z_m=1.73))
    near = np.hypot(cloud[:, 0], cloud[:, 1]) < 19.0
    height = cloud[:, 2] + 1.73
    car = near & np.isin(label, (CAR, MOVING_CAR)) & (height > 0.6) & (height < 1.5)
    car_cells = [c for c, n in cell_counts(cloud[car, :2], 0.2).items() if n >= 3]
    other = set(cell_counts(cloud[near & (label != ROAD), :2], 0.2))
    road = cell_counts(cloud[near & (label == ROAD), :2], 0.2)
    road_cells = [c for c, n in road.items() if n >= 3 and c not in other]
    assert len(road_cells) > 500
    assert share(grid, road_cells, 0) > 0.97
    if car_cells:
        assert share(grid, car_cells, 100) > 0.95
