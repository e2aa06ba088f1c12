"""Where the robot can get to in a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene import Scene
from edge.tasks.value_map import open_cells
from edge.trajectory.astar import Plan, Workspace, plan
from edge.trajectory.costmap import OCCUPIED, CostMap, from_occupancy, from_weights
from edge.trajectory.smoothing import line_is_free, smooth

ESCAPE_M = 0.6
"""A robot that stands closer to something than it may drive begins at the nearest cell so near."""
ASIDE = 5
"""Ground outside the regions that were chosen costs so many times as much as within them."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground of a scene for a robot of some size.

    Open is what `edge.tasks.value_map.open_cells` says.

    Attributes:
        costmap: closed cells have weight 0; costs grow towards obstacles.
        unoccupied: closed where something is, and nowhere else.
        reachable: (h, w) bool, the cells of the scene's grids: open, and connected with the robot.
    """

    scene: Scene
    costmap: CostMap
    unoccupied: CostMap
    reachable: np.ndarray
    _costmaps: dict[frozenset[int], CostMap] = field(default_factory=dict)
    _workspace: Workspace = field(default_factory=Workspace)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Whether the robot can be there, and get there."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        return cell is not None and bool(self.reachable[cell])

    def sees(self, a_m: tuple[float, float], b_m: tuple[float, float]) -> bool:
        """Whether a straight line between two points meets nothing that is occupied."""
        return line_is_free(self.unoccupied, a_m, b_m)

    def region_at(self, x_m: float, y_m: float) -> int:
        """The id of the drivable region at a point; 0 where there is none."""
        cell = self.scene.regions_grid.cell_of(x_m, y_m)
        return 0 if cell is None else int(self.scene.regions_grid.cells[cell])

    def nearest(
        self, x_m: float, y_m: float, within_m: float = math.inf, region: int | None = None
    ) -> tuple[float, float] | None:
        """The reachable point nearest to another: itself, or the centre of a cell.

        Args:
            region: the id of the only region to look in; None: anywhere.

        Returns:
            (x_m, y_m); None where nothing is near enough.
        """
        if self.is_free(x_m, y_m) and region in (None, self.region_at(x_m, y_m)):
            return x_m, y_m
        wanted = self.reachable
        if region is not None:
            wanted = wanted & (self.scene.regions_grid.cells == region)
        centres_m = self.scene.occupancy.centres_m(*np.nonzero(wanted))
        if not len(centres_m):
            return None
        distance_m = np.hypot(*(centres_m - (x_m, y_m)).T)
        k = int(np.argmin(distance_m))
        x, y = centres_m[k].tolist()
        return (x, y) if distance_m[k] <= within_m else None

    def plan(
        self,
        start_m: tuple[float, float],
        goal_m: tuple[float, float],
        regions: frozenset[int] = frozenset(),
        spacing_m: float = 0.5,
    ) -> Plan:
        """The cheapest way over open ground, straightened.

        Args:
            regions: ids; other ground costs `ASIDE` times as much. Empty: all ground is the same.
            spacing_m: between two points, at most.
        """
        costmap = self._costmap(regions)
        found = plan(costmap, start_m, goal_m, self._workspace, escape_m=ESCAPE_M)
        return replace(found, path_m=smooth(costmap, found.path_m, spacing_m))

    def _costmap(self, regions: frozenset[int]) -> CostMap:
        if not regions:
            return self.costmap
        if regions not in self._costmaps:
            weights = self.costmap.grid.cells
            other = ~np.isin(self.scene.regions_grid.cells, list(regions))
            dearer = np.where(other, np.minimum(weights.astype(np.uint16) * ASIDE, 255), weights)
            grid = replace(self.costmap.grid, cells=dearer.astype(np.uint8))
            self._costmaps[regions] = from_weights(grid, self.costmap.unit)
        return self._costmaps[regions]


def ground_of(scene: Scene, clearance_m: float) -> Ground:
    """The ground of a scene.

    Args:
        clearance_m: see `edge.tasks.value_map.closed_cells`.
    """
    occupancy = scene.occupancy
    is_open = open_cells(occupancy, scene.regions_grid, clearance_m)
    cells = np.where(is_open, np.int8(0), np.int8(OCCUPIED))
    costmap = from_occupancy(replace(occupancy, cells=cells))
    solid = (occupancy.cells < OCCUPIED).astype(np.uint8)
    unoccupied = from_weights(replace(occupancy, cells=solid))
    return Ground(scene, costmap, unoccupied, reachable(is_open, occupancy, scene.pose))


def reachable(is_open: np.ndarray, grid: Grid, pose: SE2) -> np.ndarray:
    """(h, w) bool: open cells that are connected with the robot's, or, where that is closed, with
    the nearest open one within `ESCAPE_M`.

    Args:
        is_open: (h, w) bool, the cells of `grid`.
    """
    rows, columns = np.nonzero(is_open)
    away_m = np.hypot(*(grid.centres_m(rows, columns) - (pose.x_m, pose.y_m)).T)
    cell = grid.cell_of(pose.x_m, pose.y_m)
    if cell is None or not len(away_m) or not (is_open[cell] or away_m.min() <= ESCAPE_M):
        return np.zeros(is_open.shape, bool)
    begin = cell if is_open[cell] else (rows[np.argmin(away_m)], columns[np.argmin(away_m)])
    # A* cuts no corner, so what it reaches is connected by sides.
    _, parts = cv2.connectedComponents(is_open.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return parts == parts[begin]


def footprint_m(half_m: np.ndarray, heading_rad: float, angle_rad: float) -> float:
    """How far a box reaches from its middle in a direction: its support function.

    Args:
        half_m: (2,) half its length and width.
    """
    turn = angle_rad - heading_rad
    return abs(math.cos(turn)) * float(half_m[0]) + abs(math.sin(turn)) * float(half_m[1])
