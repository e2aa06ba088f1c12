"""Data that a comparison takes from the worlds: floor plans, and distances left at first sight."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from edge.geometry import Grid, downsample
from edge.lab.eval import geodesic
from edge.lab.eval.comparison.outcomes import Outcomes
from edge.lab.eval.metrics import REACHED_M
from edge.lab.report import raster
from edge.lab.sim.base import World, WorldObject, objects_named

MAX_SIDE_PX = 320  # longest side of a drawing
_MARGIN_M = 0.3  # around the reachable floor
_WALL_M = 0.3  # drawn thickness of walls next to the floor


@dataclass(frozen=True, eq=False)
class FloorPlanDrawing:
    """A world from above, cut to the area around the reachable floor.

    Attributes:
        png: content of the picture; north (larger y) is at the top.
        left_m: x of the left edge, in `map`.
        top_m: y of the upper edge, in `map`.
        width_m: extent in x.
        height_m: extent in y.
        footprints: by target, the corners (k, 2) of its objects.
    """

    png: bytes
    left_m: float
    top_m: float
    width_m: float
    height_m: float
    footprints: dict[str, list[np.ndarray]]


def draw(world: World, targets: list[str], robot_radius_m: float) -> FloorPlanDrawing:
    """Draw a world and the footprints of targets.

    Free floor is white, furniture grey, walls dark, and the outside pale.
    """
    cells = _cells(world, robot_radius_m)
    inside = np.argwhere(cells.cells >= 0)
    grid = _cut(cells, inside) if len(inside) else cells
    grid = downsample(grid, MAX_SIDE_PX)
    image = raster.colour(grid.cells)[::-1, :, ::-1]  # north up; OpenCV has BGR
    _, png = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    rows, columns = grid.cells.shape
    left, bottom = grid.origin_xy_m
    width, height = columns * grid.resolution_m, rows * grid.resolution_m
    footprints = {t: [corners_m(o) for o in objects_named(world, t)] for t in targets if t}
    return FloorPlanDrawing(png.tobytes(), left, bottom + height, width, height, footprints)


def corners_m(item: WorldObject) -> np.ndarray:
    """Return (4, 2) float64: the corners of an object's box on the floor, in `map`, in order."""
    half = 0.5 * np.array(item.size_m[:2])
    c, s = np.cos(item.yaw_rad), np.sin(item.yaw_rad)
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half
    return corners @ np.array([[c, s], [-s, c]]) + np.array(item.center_m[:2])


def _cells(world: World, robot_radius_m: float) -> Grid:
    """Return int8 cells: 100 wall, 50 furniture, 0 free, -1 outside the reachable area."""
    plan = world.plan
    grid, cell_m = plan.grid, plan.grid.resolution_m
    furniture = np.zeros(grid.cells.shape, np.uint8)
    for item in world.objects:
        corners = np.rint(grid.to_cells(corners_m(item)) - 0.5).astype(np.int32)
        cv2.fillPoly(furniture, [corners], 1)
    furniture = cv2.dilate(furniture, np.ones((3, 3), np.uint8)) > 0
    occupied = grid.cells > 0
    _, component = cv2.connectedComponents((~occupied).astype(np.uint8), connectivity=4)
    reachable = plan.reachable(world.start.x_m, world.start.y_m, robot_radius_m)
    # Floor is all free space that is connected with reachable cells.
    floor = np.isin(component, np.unique(component[reachable])) & ~occupied
    wide = 2 * round(_WALL_M / cell_m) + 1
    shown = cv2.dilate(floor.astype(np.uint8), np.ones((wide, wide), np.uint8)) > 0
    cells = np.full(grid.cells.shape, -1, np.int8)
    cells[occupied & (shown | furniture)] = 100
    cells[occupied & furniture] = 50
    cells[floor] = 0
    return Grid(cells, grid.origin_xy_m, cell_m)


def _cut(grid: Grid, inside: np.ndarray) -> Grid:
    """Cut a grid to the cells `inside`, (n, 2) rows and columns, and a margin."""
    margin = round(_MARGIN_M / grid.resolution_m)
    (r0, c0), (r1, c1) = inside.min(axis=0) - margin, inside.max(axis=0) + margin + 1
    r0, c0 = max(int(r0), 0), max(int(c0), 0)
    origin = grid.to_metres(np.array([c0, r0]))
    return Grid(grid.cells[r0:r1, c0:c1], tuple(origin.tolist()), grid.resolution_m)


def fill_left_at_sight_m(
    world: World, episodes: list[int], outcomes: Outcomes, radius_m: float, out_m: np.ndarray
) -> None:
    """Fill in the distance that was left when a robot of this radius first saw its target.

    `episodes` are the indices of those in this world. Their entries of `out_m`, (A, E) float64, are
    set if the target was seen.
    """
    for target in sorted({str(outcomes.target[e]) for e in episodes} - {""}):
        objects = objects_named(world, target)
        if not objects:
            continue
        distances_m = geodesic.distance_field(world.plan, objects, radius_m, REACHED_M)
        for (a, e), outcome in outcomes.at.items():
            seen_m = outcomes["first_sight_path_m"][a, e]
            if e in episodes and outcomes.target[e] == target and np.isfinite(seen_m):
                place = point_along(np.array(outcome.trail or [outcome.start[:2]]), seen_m)
                out_m[a, e] = nearest_value(world, distances_m, place)


def point_along(trail_m: np.ndarray, path_m: float) -> np.ndarray:
    """Return the (2,) point on a polyline (n, 2) at a distance from its start, at most its end."""
    steps = np.hypot(*np.diff(trail_m, axis=0).T)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    return np.array([np.interp(path_m, driven, trail_m[:, k]) for k in (0, 1)])


def nearest_value(world: World, field: np.ndarray, xy_m: np.ndarray) -> float:
    """Return the field's value at a place, else the smallest within 0.5 m; NaN if there is none.

    The place of a robot that stands close to a wall has no value.
    """
    grid = world.plan.grid
    reach = int(0.5 / grid.resolution_m)
    column, row = np.floor(grid.to_cells(xy_m)).astype(int)
    exact = world.plan.grid.cell_of(*xy_m.tolist())
    if exact is not None and np.isfinite(field[exact]):
        return float(field[exact])
    rows = slice(max(row - reach, 0), max(row + reach + 1, 0))
    around = field[rows, max(column - reach, 0) : max(column + reach + 1, 0)]
    around = around[np.isfinite(around)]
    return float(around.min()) if len(around) else float("nan")
