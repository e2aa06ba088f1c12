"""Makes outdoor episodes: a street as a LiDAR sees it, an instruction, and its reference.

    for number in range(200):
        episode = outdoor_episode(number)

All data is known, not perceived: occupancy, regions and boxes are the street's own, and the points
are those of a LiDAR with 64 rings. An object without points is not in the scene.

`edge.lab.eval.trajectories.references` makes the task and its reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge.geometry import SE2, Grid, se3
from edge.lab.eval.trajectories.references import (
    KINDS,
    Landmark,
    ReferenceScene,
    TrajectoryTask,
    box_outline_m,
    possible_tasks,
)
from edge.lab.sim import kernels
from edge.lab.sim.base import FLOOR_CLEARANCE_M, LidarRays, box_distances_m
from edge.lab.sim.boxworld import Primitive, geometry_row
from edge.lab.sim.generator.rng import PortableRng
from edge.lab.sim.street import Street, StreetObject, solids, street
from edge.tasks.scene.ground import reachable
from edge.tasks.scene.scene import Region, Scene, SceneObject
from edge.tasks.scene.value_map import closed_cells

CELL_M = 0.2  # side of a cell of the grids
ROBOT_M = 0.4  # radius of the robot
HEIGHT_M = 1.0  # height of the robot
TASK_M = 7.0, 36.0
"""Smallest and largest distance of a task's objects from the robot."""
RINGS, COLUMNS, RANGE_M = 64, 1024, 60.0  # of the LiDAR: rays in a column and in a row, and range
ELEVATION_RAD = math.radians(-24.8), math.radians(2.0)
"""Elevations of an HDL-64E, the LiDAR of SemanticKITTI."""
LIDAR_M = 1.73  # height of the LiDAR above the ground
MIN_POINTS = 8  # an object with fewer points is not in the scene
_X_M, _Y_M = (-12.0, 44.0), (-20.0, 20.0)  # extent of the occupancy grid in `map`
_TRIES = 200  # streets to draw for an episode
_KEY = 17  # first part of the seeds, different from those of other modules


class OutdoorEpisode(NamedTuple):
    """A task in a street.

    Attributes:
        scene: without a camera; the robot stands at the origin of `map`.
        place: the objects from which the task is made.
        task: the instruction and its reference.
    """

    scene: Scene
    place: ReferenceScene
    task: TrajectoryTask


def outdoor_episode(number: int) -> OutdoorEpisode:
    """Return the episode of a number. It is the same on every computer; kinds take turns.

    Streets are drawn until one has a task of that kind.
    """
    kind = KINDS[number % len(KINDS)]
    for attempt in range(_TRIES):
        scene, _ = outdoor_scene(street(number, attempt))
        place = place_of(scene)
        task = next(possible_tasks(place, kind, PortableRng(_KEY, number, attempt)), None)
        if task is not None:
            return OutdoorEpisode(scene, place, task)
    raise AssertionError(f"episode {number}: none of {_TRIES} drawn streets has a task")


def outdoor_scene(this_street: Street) -> tuple[Scene, np.ndarray]:
    """Return the scene of a street, and the scan (n, 3) float32 in `map`."""
    floor, standing = solids(this_street)
    parts = floor + [part for _, solid in standing for part in solid]
    shape = np.array([part.shape for part in parts], np.uint8)
    boxes = np.array([geometry_row(part) for part in parts])
    cloud_m = _scan(shape, boxes)
    occupancy = _occupancy(shape, boxes)
    regions_grid = _regions_grid(this_street, occupancy)
    robot_pose = SE2(0.0, 0.0, 0.0)
    can_reach = reachable(~closed_cells(occupancy, ROBOT_M), occupancy, robot_pose)
    objects = {}
    seen = [(street_object, _points_on(solid, cloud_m)) for street_object, solid in standing]
    start = this_street.start
    seen.sort(key=lambda item: math.dist((item[0].x_m, item[0].y_m), (start.x_m, start.y_m)))
    for street_object, points_m in seen:
        pose = this_street.to_map(street_object.x_m, street_object.y_m, street_object.yaw_rad)
        if len(points_m) >= MIN_POINTS and occupancy.cell_of(pose.x_m, pose.y_m) is not None:
            number = len(objects) + 1
            objects[number] = _object(
                number, street_object, pose, points_m, regions_grid, can_reach
            )
    regions = {}
    for ground in this_street.grounds:
        cells = int((regions_grid.cells == ground.id).sum())
        if cells:
            regions[ground.id] = Region(ground.id, ground.label, cells * CELL_M**2)
    # Without a picture, its camera, and outlines in it.
    scene = Scene(0, robot_pose, objects, regions, occupancy, regions_grid, None, None, None, {})
    return scene, cloud_m


def place_of(scene: Scene) -> ReferenceScene:
    """Return the place from which a street's tasks are drawn."""
    landmarks = tuple(
        Landmark(
            # The caption is "colour label, size", so the text before the label is the colour.
            item.id, item.label, item.caption.partition(item.label)[0].strip(),
            item.position_m[:2],
            box_outline_m(item.position_m, item.size_m, item.heading_rad),
        )
        for item in scene.objects.values()
    )  # fmt: skip
    drivable = scene.regions_grid.cells > 0
    return ReferenceScene(scene.pose, landmarks, scene.occupancy, drivable, ROBOT_M, TASK_M)


def _scan(shape: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the points that the LiDAR at the origin of `map` sees, (n, 3) float32.

    Each primitive has its shape in (p,) uint8, and its `geometry_row` in (p, 8) float64.
    """
    fan = LidarRays.between(*ELEVATION_RAD, RINGS, COLUMNS, RANGE_M)
    ranges_m = np.empty((RINGS, COLUMNS), np.float32)
    T_map_lidar = se3(0.0, 0.0, LIDAR_M)
    kernels.cast_fan(
        shape, boxes, T_map_lidar, fan.directions, fan.el_min_rad, fan.el_step_rad, ranges_m
    )
    hit = ranges_m <= fan.range_m
    points = fan.directions[hit] * ranges_m[hit][:, None] + T_map_lidar[:3, 3]
    return points.astype(np.float32)


def _occupancy(shape: np.ndarray, boxes: np.ndarray) -> Grid:
    """Return a grid that is occupied between the ground and the robot's height, else free.

    See `_scan` for the arguments.
    """
    columns, rows = (round((high - low) / CELL_M) for low, high in (_X_M, _Y_M))
    solid = np.zeros((rows, columns), np.uint8)
    origin = np.array([_X_M[0], _Y_M[0]])
    kernels.rasterise(shape, boxes, FLOOR_CLEARANCE_M, HEIGHT_M, origin, CELL_M, solid)
    return Grid((solid * 100).astype(np.int8), (_X_M[0], _Y_M[0]), CELL_M)


def _regions_grid(this_street: Street, occupancy: Grid) -> Grid:
    """Return the ground's id in each cell, uint8; 0: no ground."""
    centres_m = occupancy.centres_m(*np.indices(occupancy.cells.shape))
    return replace(occupancy, cells=this_street.ground_at(centres_m))


def _object(
    number: int,
    street_object: StreetObject,
    pose: SE2,
    points_m: np.ndarray,
    regions: Grid,
    can_reach: np.ndarray,
) -> SceneObject:
    length, width, height = street_object.size_m
    position_m = np.array([pose.x_m, pose.y_m, 0.5 * height])
    size_m = np.array(street_object.size_m)
    nearest = {}
    for region in np.unique(regions.cells[can_reach & (regions.cells > 0)]).tolist():
        centres = regions.centres_m(*np.nonzero((regions.cells == region) & can_reach))
        gaps = box_distances_m(centres, position_m, size_m, pose.yaw_rad)
        nearest[region] = tuple(centres[int(np.argmin(gaps))].tolist())
    size = f"{length:.1f} x {width:.1f} x {height:.1f} m"
    return SceneObject(
        id=number,
        label=street_object.label,
        caption=f"{street_object.colour} {street_object.label}, {size}".strip(),
        position_m=position_m,
        size_m=size_m,
        heading_rad=pose.yaw_rad,
        points_m=points_m,
        nearest_m=nearest,
    )


def _points_on(parts: Sequence[Primitive], cloud_m: np.ndarray) -> np.ndarray:
    """Return the points (n, 3) of a scan that are on one of these parts."""
    centers = np.array([part.center_m for part in parts], np.float32)
    halves = 0.5 * np.array([part.size_m for part in parts], np.float32) + 0.01
    # First take the points in a box around all parts, then test each part in its own frame.
    reach = np.linalg.norm(halves, axis=1)[:, None]
    low, high = (centers - reach).min(axis=0), (centers + reach).max(axis=0)
    near = cloud_m[((cloud_m > low) & (cloud_m < high)).all(axis=1)]
    on = np.zeros(len(near), bool)
    for part, center, half in zip(parts, centers, halves, strict=True):
        c, s = math.cos(part.yaw_rad), math.sin(part.yaw_rad)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
        local = np.abs((near - center) @ turn) / half  # 1 is on the surface
        is_ellipsoid = part.shape == kernels.ELLIPSOID
        size = np.linalg.norm(local, axis=1) if is_ellipsoid else local.max(axis=1, initial=0.0)
        on |= size <= 1.0
    return near[on]
