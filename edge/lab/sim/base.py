"""Interface of all simulated worlds: objects, floor plan, and views by camera and LiDAR."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from edge import names
from edge.config import Lidar
from edge.errors import UserError
from edge.geometry import SE2, CameraModel, Grid

# The robot drives over sills and carpets that are lower than this.
FLOOR_CLEARANCE_M = 0.05


Room = tuple[tuple[float, float, float, float], ...]
"""Rectangles (x0, y0, x1, y1) [m] that make up the room's floor."""


class WorldError(UserError):
    """Error of a world that cannot be used; the message names file, place and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class WorldObject:
    """An object in a world.

    Attributes:
        id: value in the images of object ids, from 1.
        label: common name (`edge.names`).
        category: name in the world's file.
        center_m: centre of its box, in `map`.
        size_m: extents of the box along its own x, y, z.
        footprint_m: (k, 2) float32 samples of the floor that it covers; None for the entire box.
    """

    id: int
    name: str
    label: str
    category: str
    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float
    footprint_m: np.ndarray | None = None

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Return the planar distance from a point to the footprint; 0 inside a box."""
        if self.footprint_m is not None:
            d = self.footprint_m - np.array([x_m, y_m], dtype=np.float32)
            return float(np.sqrt((d * d).sum(axis=1).min()))
        dx, dy = x_m - self.center_m[0], y_m - self.center_m[1]
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        a = max(0.0, abs(c * dx + s * dy) - 0.5 * self.size_m[0])
        b = max(0.0, abs(c * dy - s * dx) - 0.5 * self.size_m[1])
        return math.hypot(a, b)


def box_distances_m(
    xy_m: np.ndarray, center_m: Sequence[float], size_m: Sequence[float], yaw_rad: float
) -> np.ndarray:
    """Return the planar distance of points (n, 2) from a box, (n,) float64; 0 inside."""
    dx, dy = (xy_m - np.array(center_m[:2])).T
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    along = np.maximum(np.abs(c * dx + s * dy) - 0.5 * size_m[0], 0.0)
    across = np.maximum(np.abs(c * dy - s * dx) - 0.5 * size_m[1], 0.0)
    return np.hypot(along, across)


@dataclass(frozen=True, slots=True, eq=False)
class LidarRays:
    """Rays of a rotating LiDAR in its own frame.

    Attributes:
        directions: (rings, columns, 3) float64 unit vectors; ring r at elevation `el_min_rad + r
            el_step_rad`, column c at azimuth `-pi + c 2 pi / columns`.
        el_min_rad: elevation of the first ring.
        el_step_rad: elevation step between rings.
        range_m: objects farther away give no return.
    """

    directions: np.ndarray
    el_min_rad: float
    el_step_rad: float
    range_m: float

    @classmethod
    def of(cls, lidar: Lidar) -> LidarRays:
        """Return the rays of a configured LiDAR; a single ring has elevation 0."""
        half_rad = 0.0 if lidar.rings == 1 else 0.5 * math.radians(lidar.vfov_deg)
        return cls.between(-half_rad, half_rad, lidar.rings, lidar.columns, lidar.range_m)

    @classmethod
    def between(
        cls, low_rad: float, high_rad: float, rings: int, columns: int, range_m: float
    ) -> LidarRays:
        """Return the rays of rings that are spread evenly between two elevations."""
        step = 1.0 if rings == 1 else (high_rad - low_rad) / (rings - 1)
        el = (low_rad + step * np.arange(rings))[:, None]
        az = (-math.pi + 2 * math.pi / columns * np.arange(columns))[None]
        parts = (np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0 * az)
        return cls(np.stack(parts, axis=-1), low_rad, step, range_m)


class FloorPlan:
    """Raster of the geometry from 0.05 m above the floor up to the robot's height.

    Attributes:
        grid: uint8, 1 = occupied.
        clearance_m: (rows, columns) float32, distance to the nearest occupied cell's edge.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.clearance_m = np.empty(grid.cells.shape, np.float32)
        self.update()

    def update(self) -> None:
        """Compute the clearance again after the grid's cells have changed."""
        free, cell_m = np.uint8(1) - self.grid.cells, self.grid.resolution_m
        distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        np.multiply(distance, cell_m, out=self.clearance_m)
        np.maximum(self.clearance_m - 0.5 * cell_m, 0.0, out=self.clearance_m)

    def clearance_at(self, x_m: float, y_m: float) -> float:
        """Return the distance to the nearest obstacle, exact to a cell.

        It is 0 inside an obstacle or off the plan.
        """
        cell = self.grid.cell_of(x_m, y_m)
        return 0.0 if cell is None else float(self.clearance_m[cell])

    def reachable(self, x_m: float, y_m: float, clearance_m: float) -> np.ndarray:
        """Return the cells that a robot of radius `clearance_m` can reach from a place.

        Returns:
            (rows, columns) bool; all False if the place itself is not free.
        """
        free = (self.clearance_m > clearance_m).astype(np.uint8)
        cell = self.grid.cell_of(x_m, y_m)
        if cell is None or not free[cell]:
            return np.zeros(free.shape, bool)
        _, component = cv2.connectedComponents(free, connectivity=4)
        return component == component[cell]


class World(Protocol):
    """A place for the simulated robot; see `edge.lab.sim.worlds.load_world`.

    Attributes:
        objects: the objects that a robot may look for; their ids count from 1.
        plan: occupied cells of the floor.
        rooms: each as rectangles of its floor (x0, y0, x1, y1) [m]; empty if unknown.
        room_kinds: kind of each room; empty if unknown.
    """

    name: str
    rooms: tuple[Room, ...]
    room_kinds: tuple[str, ...]
    objects: list[WorldObject]
    start: SE2
    plan: FloorPlan

    def render(
        self,
        camera: CameraModel,
        T_map_camera: np.ndarray,
        out_rgb: np.ndarray | None,
        out_depth_m: np.ndarray,
        out_ids: np.ndarray,
    ) -> None:
        """Render an image into the given buffers, from a pose of the camera's optical frame.

        Depth (h, w) float32 is NaN for nothing, and ids (h, w) uint16 are 0 for structure. Without
        `out_rgb`, (h, w, 3) uint8, nothing is shaded, which takes half the time; the rest is the
        same.
        """

    def cast(self, fan: LidarRays, T_map_lidar: np.ndarray, out_ranges_m: np.ndarray) -> None:
        """Measure one LiDAR sweep: fill (rings, columns) float32 with ranges [m], NaN for none."""


def objects_named(world: World, name: str) -> list[WorldObject]:
    """Return the world's objects with this name or a synonym of it; [] if there are none."""
    return [item for item in world.objects if names.same_name(item.label, name)]


def start_at(pose: SE2) -> tuple[float, float, float]:
    """Return a pose as a value of `sim.start`, with three decimals."""
    return round(pose.x_m, 3), round(pose.y_m, 3), round(pose.yaw_rad, 3)


def free_poses(
    world: World, count: int, seed: int, radius_m: float, margin_m: float = 0.1
) -> list[SE2]:
    """Return random poses that the robot can reach from the world's start, repeatably for a seed.

    The poses are at least `margin_m` farther from obstacles than the robot's radius.

    Raises:
        WorldError: the start itself is not free for this radius.
    """
    rng = np.random.default_rng(seed)
    plan = world.plan
    reachable = plan.reachable(world.start.x_m, world.start.y_m, radius_m)
    rows, cols = np.nonzero(reachable & (plan.clearance_m > radius_m + margin_m))
    if len(rows) == 0:
        raise WorldError(
            f"world {world.name}: the robot (radius {radius_m} m) does not fit at the start "
            f"({world.start.x_m:.2f}, {world.start.y_m:.2f}) m; set another start in sim.start"
        )
    picks = rng.integers(0, len(rows), count)
    yaws = rng.uniform(-math.pi, math.pi, count)
    places = plan.grid.centres_m(rows[picks], cols[picks])
    return [SE2(*xy, a) for xy, a in zip(places.tolist(), yaws.tolist(), strict=True)]
