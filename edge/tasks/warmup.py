"""Warm-up: compile the kernels of tasks before a person waits for a trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edge.config import MappingConfig, RobotConfig, TasksConfig, TrajectoryLimits
from edge.geometry import CameraModel, se3, to_optical
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.tasks.refine import refine
from edge.tasks.scene.map_scene import scene_of_map
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.scene_builder import add_detections
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.write import write_trajectory
from edge.trajectory.pursuit import MotionLimits
from edge.types import Detections, Instance, Observation

_WALL_M = 3.0  # distance of the wall
_CAMERA_M = 0.6  # height of the camera
_CLEARANCE_M = 0.1


def warm_up() -> None:
    """Do a small task: see a box, write a trajectory to it by the rules, and refine the trajectory.

    This compiles every kernel that a service calls for a task, with any configuration.
    """
    seen = room()
    box = np.array([[20, 6, 28, 20]], np.float32)
    found = Detections(seen, box, np.ones(1, np.float32), np.zeros(1, np.int32), ("box",))
    objects = ObjectMap()
    for frame in (seen, _as_cloud(seen)):
        add_detections(objects, replace(found, observation=frame), 2.0 * _WALL_M)
    grid = RollingMap(MappingConfig(extent_m=4.0 * _WALL_M))
    grid.update_depth(seen.depth_m, seen.camera, seen.T_map_base, seen.T_base_camera)
    points_m = np.array([[_WALL_M, 0.0, 0.5]], np.float32)
    obj = Instance(1, "box", points_m[0], points_m, 1.0, 1, 0, 0)
    scene = scene_of_map(MapView(grid), seen, (obj,), _CLEARANCE_M)
    limits = TasksConfig(trajectory=TrajectoryLimits(clearance_m=_CLEARANCE_M))
    coarse = write_trajectory("go to the box", scene, limits).coarse
    refine(
        scene,
        coarse.segments,
        coarse.regions,
        PathMargins(_CLEARANCE_M),
        MotionLimits.of(RobotConfig()),
    )


def room() -> Observation:
    """Return a depth image of a wall ahead over a bare floor."""
    camera = CameraModel.from_hfov(48, 40, 1.6)
    rows = np.arange(camera.height_px) - camera.cy_px
    with np.errstate(divide="ignore"):
        floor_m = np.where(rows > 0.0, camera.fy_px * _CAMERA_M / rows, np.inf)
    depth_m = np.minimum(np.broadcast_to(floor_m[:, None], (40, 48)), _WALL_M).astype(np.float32)
    T = to_optical(se3(z_m=_CAMERA_M))
    return Observation(0, 0, np.eye(4), depth_m=depth_m, camera=camera, T_base_camera=T)


def _as_cloud(seen: Observation) -> Observation:
    """Return an observation of random points in place of the depth image."""
    cloud_m = np.random.default_rng(0).uniform(0.5, _WALL_M, (64, 3)).astype(np.float32)
    return replace(seen, depth_m=None, cloud_m=cloud_m)
