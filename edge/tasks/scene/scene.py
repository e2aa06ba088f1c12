"""Scene: what is around the robot, for the writer of a trajectory (OpenNav III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.geometry import SE2, CameraModel, Grid


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """An object, its place in `map`, and the points nearest to it that the robot can reach.

    Attributes:
        id: number in the picture and in texts; unique in a scene, from 1.
        label: canonical name.
        caption: further description: colour, size, place.
        position_m: (3,) float64, centre of its box.
        size_m: (3,) float64, size of its box along the heading, across it, and up.
        heading_rad: direction of the longer side of its box.
        points_m: (n, 3) float32 in `map`.
        nearest_m: nearest reachable point (x, y) of each drivable region, by the region's id.
    """

    id: int
    label: str
    caption: str
    position_m: np.ndarray
    size_m: np.ndarray
    heading_rad: float
    points_m: np.ndarray
    nearest_m: dict[int, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Region:
    """Connected ground that may be driven over.

    Attributes:
        id: unique in a scene, from 1; value of its cells in `Scene.regions_grid`.
        label: road, sidewalk, floor, ….
        area_m2: area that was seen.
    """

    id: int
    label: str
    area_m2: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything around the robot at one instant, in `map`.

    Attributes:
        stamp_ns: time of the newest observation in the scene.
        pose: the robot's pose.
        objects: objects by id.
        regions: drivable regions by id.
        occupancy: int8; -1 unknown, 0 free, 100 occupied.
        regions_grid: uint8, the same cells: id of the region, 0 = none.
        rgb: (h, w, 3) uint8, the newest picture; None without a camera.
        camera: intrinsics of `rgb`; None without a picture.
        T_map_camera: (4, 4) pose of the camera for `rgb`; None without a picture.
        contours: outlines of each object in `rgb`, by id: list of (k, 2) int32 polygons in pixels.
    """

    stamp_ns: int
    pose: SE2
    objects: dict[int, SceneObject]
    regions: dict[int, Region]
    occupancy: Grid
    regions_grid: Grid
    rgb: np.ndarray | None
    camera: CameraModel | None
    T_map_camera: np.ndarray | None
    contours: dict[int, list[np.ndarray]]
