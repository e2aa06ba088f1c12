"""What is around the robot, as it is described to who writes a trajectory (OpenNav III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.geometry import SE2, CameraModel, Grid


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """A thing, its place in `map`, and where one can get nearest to it.

    Attributes:
        id: its number, in the picture and in words; unique in a scene, from 1.
        label: canonical name.
        caption: what is said of it besides: colour, size, place.
        position_m: (3,) float64, the middle of its box.
        size_m: (3,) float64, along its heading, across it, and up.
        heading_rad: of its longer side.
        points_m: (n, 3) float32 in `map`.
        nearest_m: the nearest reachable point (x, y) of each drivable region, by the region's id.
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
    """Ground that may be driven over.

    Attributes:
        id: unique in a scene, from 1; also its number in `Scene.regions_grid`.
        label: road, sidewalk, floor, ….
        area_m2: how much of it is seen.
    """

    id: int
    label: str
    area_m2: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All of it at one instant, in `map`.

    Attributes:
        stamp_ns: of the newest observation in it.
        pose: where the robot stands.
        objects: by id.
        regions: drivable ones, by id.
        occupancy: int8; -1 unknown, 0 free, 100 occupied.
        regions_grid: uint8, the same cells: the region's id, 0 where there is none.
        rgb: (h, w, 3) uint8, the newest picture; None: there is no camera.
        camera, T_map_camera: of `rgb`; None without.
        contours: of each object in `rgb`, by id: list of (k, 2) int32 polygons in pixels.
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
