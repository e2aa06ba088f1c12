"""Warm-up: compile the mapping kernels before the first observation needs them."""

from __future__ import annotations

import numpy as np

from edge import config
from edge.geometry import SE2, CameraModel
from edge.mapping.coverage import Viewpoint
from edge.mapping.grid import RollingMap
from edge.mapping.layers import read_only
from edge.types import Observation


def warmup(mapping: config.MappingConfig) -> None:
    """Compile the kernels that every map needs, on a small map."""
    grid, camera, T = _small_map(mapping)
    depth_with_hole = np.full((16, 16), 1.0, np.float32)
    depth_with_hole[8, 8] = np.nan
    grid.update_depth(depth_with_hole, camera, np.eye(4), T)
    grid.update_cloud(np.ones((4, 3), np.float32), np.eye(4), np.eye(4))
    grid.bumps.close(SE2(0.0, 0.0, 0.0), (0.4, 0.0), 0.2, 0)
    grid.bumps.open_all()
    grid.travel_cost.step(SE2(0.0, 0.0, 0.0))
    grid.travel_cost.nearest(0.0, 0.0, 0.5)
    grid.travel_cost.stopping_point(np.zeros((1, 3), np.float32), 0.5)
    grid.travel_cost.path_xy_m(0.0, 0.0)
    indices = np.zeros(1, np.int32)
    grid.gain.around(grid.frontiers.xy_m, indices, 1, np.zeros(1, np.float32))
    grid.gain.on_view(SE2(0.0, 0.0, 0.0), 0.0, 1.0)
    grid.gain.best_spin(SE2(0.0, 0.0, 0.0), 0.0, 1.0)
    grid.coverage.on_image(Observation(0, 0, np.eye(4), camera=camera), 1.0, 1)
    grid.coverage.search(grid.travel_cost)
    grid.coverage.is_worth_visiting(Viewpoint(0.0, 0.0, 0.0))
    points_m = read_only(grid.frontiers.xy_m)
    grid.unknown.ratio(points_m, 1, mapping.resolution_m, np.zeros(8, np.float32))
    grid.snapshot()
    _ = grid.known_m2
    grid.state_dict()
    one_window_m = grid.window.n * grid.resolution_m
    # The window moves.
    grid.update_depth(
        np.full((16, 16), 1.0, np.float32), camera, SE2(one_window_m, 0.0, 0.0).matrix(), T
    )


def warm_values(mapping: config.MappingConfig) -> None:
    """Compile the kernels of value maps."""
    grid, camera, T = _small_map(mapping)
    grid.update_depth(np.full((16, 16), 1.0, np.float32), camera, np.eye(4), T)
    grid.values.set_targets(("x",))
    for depth in (None, np.full((16, 16), 1.0, np.float32)):
        profile = grid.values.range_profile(Observation(0, 0, T, depth_m=depth, camera=camera))
        assert profile is not None
        grid.values.write_view(profile, ("x",), np.ones(1, np.float32))
        grid.values.write_directions(profile, "x", np.ones((1, 2), np.float32), np.ones(1), 1.0)
    grid.values.best(0, read_only(grid.frontiers.xy_m), 1, 0.5, np.zeros(8, np.float32))


def _small_map(mapping: config.MappingConfig) -> tuple[RollingMap, CameraModel, np.ndarray]:
    """Return a small map, a camera, and the camera's pose on the robot."""
    grid = RollingMap(mapping.model_copy(update={"extent_m": 1.0}))
    T = np.eye(4)
    T[:3, :3] = ((0, 0, 1), (-1, 0, 0), (0, -1, 0))
    T[2, 3] = 0.5
    return grid, CameraModel.from_hfov(16, 16, 1.2), T
