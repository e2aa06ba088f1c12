"""Terrain: height of the ground, drivable regions, and their points nearest to an object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene import scan_kernels as kernels
from edge.tasks.scene.outline import squares_of_distances
from edge.tasks.scene.scene import Region

CELL_M = 0.5
"""Side of a cell in grids of the ground's height."""
STEP_M, SLOPE = 0.08, 0.1
"""Neighbouring ground differs in height by at most `STEP_M` plus `SLOPE` times the distance.

A kerb is higher."""
GAP_M = 4.0
"""Largest gap between scan lines over which the ground is followed."""
FILL_M, FILL_SHARE = 1.5, 0.06
"""Ground between scan lines takes the nearest kind that was seen within a distance.

The distance is `FILL_M` plus `FILL_SHARE` times the distance from the robot, because scan lines are
farther apart far away.
"""
BLIND_M = 4.5
"""Distance within which the robot's own body may hide the ground.

A ring of an HDL-64E, 24.8 degrees down from 1.73 m, meets the ground at 3.7 m. Hidden ground takes
the nearest kind that was seen: that of its rim.
"""
MIN_REGION_M2 = 3.0
"""Smallest area of a region."""
MOST_REGIONS = 255
"""Most regions of a scene; their ids are uint8."""
GROUND = "ground"
"""Label of regions if no kinds of ground are known."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundHeight:
    """Height of the ground around the robot.

    Attributes:
        height_m: float32, in `map`; cells that were not seen have the height of the nearest ground.
        seen: bool, the same cells; True if the ground in the cell was seen.
    """

    height_m: Grid
    seen: Grid


def estimate_ground(
    points_m: np.ndarray, x_m: float, y_m: float, z_m: float, range_m: float
) -> GroundHeight:
    """Estimate the ground, followed from the robot outwards through the lowest point of each cell.

    Args:
        points_m: (n, 3) float32 in `map`.
        x_m: x of the point where the robot touches the ground.
        y_m: y of that point.
        z_m: z of that point.
        range_m: largest distance from the robot.
    """
    half = math.ceil(range_m / CELL_M)
    origin = (math.floor(x_m / CELL_M) - half) * CELL_M, (math.floor(y_m / CELL_M) - half) * CELL_M
    side = 2 * half + 1
    low = np.full((side, side), np.inf, np.float32)
    height, seen = np.empty_like(low), np.empty((side, side), np.bool_)
    with np.errstate(invalid="ignore"):
        column, row = np.floor((points_m[:, :2] - origin) / CELL_M).T
        inside = (row >= 0) & (row < side) & (column >= 0) & (column < side)
        inside &= np.isfinite(points_m[:, 2])
    at = (row[inside] * side + column[inside]).astype(np.intp)
    np.minimum.at(low.reshape(-1), at, points_m[inside, 2])
    kernels.grow_ground(
        low, half, half, z_m, STEP_M, SLOPE, CELL_M, round(GAP_M / CELL_M), height, seen
    )
    return GroundHeight(Grid(height, origin, CELL_M), Grid(seen, origin, CELL_M))


def height_above(ground: GroundHeight, points_m: np.ndarray) -> np.ndarray:
    """Return the height of points over the ground, (n,) float32 metres; NaN outside its grid."""
    grid = ground.height_m
    with np.errstate(invalid="ignore"):
        column, row = np.floor(grid.to_cells(points_m[:, :2])).T
        h, w = grid.cells.shape
        inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    out = np.full(len(points_m), np.nan, np.float32)
    at = row[inside].astype(np.intp), column[inside].astype(np.intp)
    out[inside] = points_m[inside, 2] - grid.cells[at]
    return out


def with_blind_spot(occupancy: Grid, pose: SE2) -> Grid:
    """Return a map in which the ground under the robot is joined to the ground that it sees.

    No sensor sees the ground under itself: a LiDAR's lowest ring meets it metres away. If the free
    ground around the robot is smaller than a region (`MIN_REGION_M2`), unknown cells become free on
    the straight lines to the first known ground, at most `BLIND_M` away. Lines that first meet an
    occupied cell, or no known cell, change nothing.

    Args:
        occupancy: int8; -1 unknown, 0 free, 100 occupied.
        pose: pose of the robot.
    """
    cells, step_m = occupancy.cells, 0.5 * occupancy.resolution_m
    cell = occupancy.cell_of(pose.x_m, pose.y_m)
    if cell is None:
        return occupancy
    free = cells == 0
    _, part = cv2.connectedComponents(free.view(np.uint8), connectivity=4)
    around_robot = free & (part == part[cell])
    if around_robot.sum() * occupancy.resolution_m**2 >= MIN_REGION_M2:
        return occupancy
    # Lines start inside the robot's own free ground, so it counts as unknown.
    state = np.where(around_robot, np.int8(-1), cells)
    # Points on straight lines from the robot: (2, lines, points of a line).
    angle_rad = np.arange(0.0, 2.0 * np.pi, step_m / BLIND_M)[:, None]
    away_m = np.arange(0.0, BLIND_M, step_m)
    xy_m = np.stack((pose.x_m + away_m * np.cos(angle_rad), pose.y_m + away_m * np.sin(angle_rad)))
    column, row = np.floor(np.moveaxis(occupancy.to_cells(np.moveaxis(xy_m, 0, -1)), -1, 0))
    h, w = cells.shape
    inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    at = row.clip(0, h - 1).astype(np.intp), column.clip(0, w - 1).astype(np.intp)
    known = inside & (state[at] >= 0)
    # For each line the first known point; True if it is free; then the points before it.
    first = np.argmax(known, axis=1)
    lines = np.arange(len(first))
    ground = known[lines, first] & (state[at][lines, first] == 0)
    hidden = ground[:, None] & (np.arange(len(away_m)) < first[:, None]) & inside
    filled = cells.copy()
    filled[at[0][hidden], at[1][hidden]] = 0
    return replace(occupancy, cells=filled)


def classify_ground(
    grid: Grid, pose: SE2, xy_m: np.ndarray, kind: np.ndarray, n_kinds: int
) -> np.ndarray:
    """Return the kind of ground of each cell, by a vote of its points.

    Args:
        grid: map with these cells; free cells without points take the nearest kind.
        pose: pose of the robot.
        xy_m: (n, 2) points on the ground in `map`.
        kind: (n,) integers from 1 to `n_kinds`; 0: not ground.
        n_kinds: number of kinds.

    Returns:
        (h, w) uint8; 0 if nothing is known, or most points are not ground.
    """
    h, w = grid.cells.shape
    if h * w == 0:
        return np.zeros((h, w), np.uint8)
    column, row = np.floor(grid.to_cells(xy_m)).astype(np.int64).reshape(-1, 2).T
    inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
    # Number of points by cell and kind, counted by one flat index.
    flat = (row * w + column)[inside] * (n_kinds + 1) + kind[inside]
    votes = np.bincount(flat, minlength=h * w * (n_kinds + 1)).reshape(h, w, n_kinds + 1)
    out = np.argmax(votes, axis=2).astype(np.uint8)
    if not out.any():
        return out
    away, nearest = _nearest_kind(out)
    rows, columns = np.mgrid[:h, :w]
    from_robot_m = np.linalg.norm(grid.centres_m(rows, columns) - (pose.x_m, pose.y_m), axis=2)
    unseen = (votes.sum(axis=2) == 0) & (grid.cells == 0)
    gap = unseen & (away * grid.resolution_m <= FILL_M + FILL_SHARE * from_robot_m)
    under = unseen & (from_robot_m < BLIND_M)
    return np.where(gap | under, nearest, out).astype(np.uint8)


def _nearest_kind(kind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each cell the distance in cells to a cell with a kind, and that kind."""
    away, label = cv2.distanceTransformWithLabels(
        (kind == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    kind_of_label = np.zeros(label.max() + 1, np.uint8)
    kind_of_label[label[kind > 0]] = kind[kind > 0]
    return away, kind_of_label[label]


def regions_of(
    occupancy: Grid, kind: np.ndarray, labels: Sequence[str]
) -> tuple[dict[int, Region], Grid]:
    """Return the connected regions of each kind of ground, without occupied cells.

    A piece smaller than `MIN_REGION_M2`, as a bare patch in a lawn, joins the region next to it.

    Args:
        occupancy: the map.
        kind: (h, w) uint8, index into `labels` plus 1; 0: not drivable.
        labels: names of the kinds.

    Returns:
        At most `MOST_REGIONS` regions by id, the largest first, and a grid with each cell's region.
    """
    found: list[tuple[int, str, np.ndarray]] = []
    min_cells = max(1.0, MIN_REGION_M2 / occupancy.resolution_m**2)
    for k, label in enumerate(labels if kind.size else (), start=1):  # OpenCV fails on no cells
        is_kind = ((kind == k) & (occupancy.cells <= 0)).astype(np.uint8)
        n, part, stats, _ = cv2.connectedComponentsWithStats(is_kind, connectivity=8)
        for i in range(1, n):
            area = int(stats[i, cv2.CC_STAT_AREA])
            if area >= min_cells:
                found.append((area, label, part == i))
    found.sort(key=lambda piece: -piece[0])
    cells = np.zeros(kind.shape, np.uint8)
    for i, (_, _, is_kind) in enumerate(found[:MOST_REGIONS], start=1):
        cells[is_kind] = i
    small = ((kind > 0) & (cells == 0) & (occupancy.cells <= 0)).astype(np.uint8)
    if cells.any() and small.any():
        _, nearest = _nearest_kind(cells)
        _, part = cv2.connectedComponents(small, connectivity=8)
        touches = cv2.dilate(cells, np.ones((3, 3), np.uint8)) > 0
        joins = (small > 0) & np.isin(part, np.unique(part[touches]))
        cells[joins] = nearest[joins]
    area_m2 = np.bincount(cells.ravel(), minlength=1) * occupancy.resolution_m**2
    regions = {
        i: Region(i, label, float(area_m2[i]))
        for i, (_, label, _) in enumerate(found[:MOST_REGIONS], start=1)
    }
    return regions, replace(occupancy, cells=cells)


def nearest_points(
    points_m: np.ndarray, regions: Grid, allowed: np.ndarray
) -> dict[int, tuple[float, float]]:
    """Return the point of each region nearest to an object, among allowed cells (OpenNav III-A2).

    Args:
        points_m: (n, 2 or more) points of the object in `map`.
        regions: grid with the region of each cell.
        allowed: (h, w) bool, see `edge.tasks.scene.ground.reachable`.

    Returns:
        Points (x, y) by the region's id, without regions that have no allowed cell.
    """
    if not len(points_m) or not regions.cells.size:
        return {}
    cells = np.floor(regions.to_cells(points_m[:, :2])).astype(np.int64)
    away = squares_of_distances(cells, regions.cells.shape)
    found = {}
    for region in np.unique(regions.cells[allowed & (regions.cells > 0)]).tolist():
        rows, columns = np.nonzero(allowed & (regions.cells == region))
        k = int(np.argmin(away[rows, columns]))
        x_m, y_m = regions.centres_m(rows[k], columns[k]).tolist()
        found[region] = (x_m, y_m)
    return found
