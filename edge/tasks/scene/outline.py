"""Outline of an object on the ground: the distance of points from it, and points to pass it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene.scene import SceneObject
from edge.trajectory.smoothing import resample

_CHUNK_POINTS = 128  # points whose distances to all cells are in memory at a time
OVERHANG_M = 1.0
"""Height above an object's lowest point from which on a part may be over free ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """An object seen from above.

    The robot is at an object when it is at what was seen of it. It passes all that the object may
    cover: a LiDAR sees only two sides of a car, but the box around a curved hedge or an L-shaped
    sofa also holds free ground.

    Attributes:
        middle_m: (2,) float64, centre of the object's box in `map`.
        cells_m: (n, 2) float64, n >= 1: centres of the cells with a point of the object, without
            parts that overhang: the crown of a tree may be over the robot. Without points, those in
            its box that are not known to be free, else points along its rim.
        hull_m: (k, 2) float64 relative to the centre, corners of the convex hull of these cells and
            of the part of the box that is not known to be free.
        rim_m: distance from the centre of a cell to its rim.
    """

    middle_m: np.ndarray
    cells_m: np.ndarray
    hull_m: np.ndarray
    rim_m: float

    def gaps_m(self, points_m: np.ndarray) -> np.ndarray:
        """Return the distance (n,) from points (n, 2) to the nearest cell; 0 on a cell."""
        away_m = np.empty(len(points_m))
        for k in range(0, len(points_m), _CHUNK_POINTS):
            apart_m = points_m[k : k + _CHUNK_POINTS, None] - self.cells_m
            away_m[k : k + _CHUNK_POINTS] = np.hypot(apart_m[..., 0], apart_m[..., 1]).min(axis=1)
        return np.maximum(away_m - self.rim_m, 0.0)

    def gaps_by_cell_m(self, grid: Grid) -> np.ndarray:
        """Return the distance of each cell's centre of the map from the nearest cell, (h, w).

        `grid` is the map of the outline. Points of a rim count as the centres of their cells. One
        distance transform is faster than all pairs of cells: a building has a thousand.
        """
        at = np.floor(grid.to_cells(self.cells_m)).astype(np.int64)
        away_cells = np.sqrt(squares_of_distances(at, grid.cells.shape))
        return np.maximum(away_cells * grid.resolution_m - self.rim_m, 0.0)

    def nearest(self, point_m: tuple[float, float]) -> tuple[float, float]:
        """Return the centre of the object's cell nearest to a point."""
        k = int(np.argmin(np.hypot(*(self.cells_m - point_m).T)))
        x_m, y_m = self.cells_m[k].tolist()
        return x_m, y_m

    def point_at(self, angle_rad: float, distance_m: float) -> tuple[float, float]:
        """Return the point in a direction from the centre, at a distance from the hull."""
        ray = np.array([math.cos(angle_rad), math.sin(angle_rad)])
        hull_along_m = self.hull_m @ ray
        # Along the ray the distance from a convex hull grows, so bisect.
        low_m = max(float(hull_along_m.mean()), 0.0)
        high_m = max(float(hull_along_m.max()), 0.0) + distance_m
        while high_m - low_m > 1e-4:
            along_ray_m = 0.5 * (low_m + high_m)
            if self._distance_to_hull_m(along_ray_m * ray) < distance_m:
                low_m = along_ray_m
            else:
                high_m = along_ray_m
        x_m, y_m = self.middle_m.tolist()
        return SE2(x_m, y_m, angle_rad).ahead(high_m)

    def _distance_to_hull_m(self, point_m: np.ndarray) -> float:
        """Return the distance of a point, relative to the centre; negative inside the hull."""
        x_m, y_m = point_m.tolist()
        return -cv2.pointPolygonTest(self.hull_m.astype(np.float32), (x_m, y_m), True)


def squares_of_distances(cells: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the squared distance of each cell of a grid from the nearest of some cells.

    Args:
        cells: (n, 2) int64, n >= 1, column and row; they may be outside the grid.
        shape: (h, w) of the grid.

    Returns:
        (h, w) float64, in cells; the values are integers, so equal distances are equal.
    """
    low = np.minimum(cells.min(axis=0), 0)
    high = np.maximum(cells.max(axis=0) + 1, shape[::-1])
    apart = np.ones((high - low)[::-1], np.uint8)
    apart[tuple((cells - low).T[::-1])] = 0
    away = cv2.distanceTransform(apart, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    (x0, y0), (h, w) = -low, shape
    return np.rint(np.square(away[y0 : y0 + h, x0 : x0 + w], dtype=np.float64))


def outline_of(obj: SceneObject, occupancy: Grid) -> Outline:
    """Return the outline of an object; `occupancy` is the map of its scene."""
    middle_m, half_m = obj.position_m[:2], 0.5 * obj.size_m[:2]
    c, s = math.cos(obj.heading_rad), math.sin(obj.heading_rad)
    turn = np.array([[c, s], [-s, c]])
    rim_m = 0.5 * occupancy.resolution_m
    seen = _arrival_cells(obj, occupancy)
    covered_m = _covered_cells(occupancy, middle_m, half_m, turn, rim_m)
    cells_m = occupancy.to_metres(seen + 0.5) if len(seen) else covered_m
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    if not len(cells_m):
        box_m = (corners * half_m) @ turn
        cells_m = resample(np.concatenate([box_m, box_m[:1]]), occupancy.resolution_m) + middle_m
        rim_m = 0.0
    covered_m = np.concatenate([cells_m, covered_m])
    # Corners of all cells, relative to the centre.
    around_m = (covered_m[:, None] - middle_m + rim_m * corners).reshape(-1, 2)
    hull_m = cv2.convexHull(around_m.astype(np.float32))[:, 0].astype(np.float64)
    return Outline(middle_m, cells_m, hull_m, rim_m)


def _arrival_cells(obj: SceneObject, occupancy: Grid) -> np.ndarray:
    """Return the cells with a point of the object, without overhanging parts; (n, 2) column, row.

    A part overhangs if it is `OVERHANG_M` above the object's lowest point and its cell is known to
    be free.
    """
    cells = np.floor(occupancy.to_cells(obj.points_m[:, :2])).astype(np.int64)
    inside = ((cells >= 0) & (cells < occupancy.cells.shape[::-1])).all(axis=1)
    column, row = np.where(inside[:, None], cells, 0).T
    is_free = inside & (occupancy.cells[row, column] == 0)
    z_m = obj.points_m[:, 2]
    overhangs = is_free & (z_m > z_m.min(initial=np.inf) + OVERHANG_M)
    return np.unique(cells[~overhangs], axis=0)


def _covered_cells(
    occupancy: Grid, middle_m: np.ndarray, half_m: np.ndarray, turn: np.ndarray, margin_m: float
) -> np.ndarray:
    """Return the centres (n, 2) of the cells in a box that are not known to be free."""
    reach_m = float(np.hypot(*half_m)) + margin_m
    low, high = (
        np.floor(occupancy.to_cells(middle_m + side * reach_m)).astype(np.int64) for side in (-1, 1)
    )
    (c0, r0), (c1, r1) = np.maximum(low, 0), np.minimum(high + 1, occupancy.cells.shape[::-1])
    if c0 >= c1 or r0 >= r1:
        return np.empty((0, 2))
    rows, columns = np.mgrid[r0:r1, c0:c1]
    centres_m = occupancy.centres_m(rows, columns)
    local_m = np.abs((centres_m - middle_m) @ turn.T)
    covered = (local_m <= half_m + margin_m).all(axis=-1) & (occupancy.cells[r0:r1, c0:c1] != 0)
    return centres_m[covered]
