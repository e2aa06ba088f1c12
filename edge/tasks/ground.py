"""Where the robot can get to in a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from edge.tasks.scene import Scene
from edge.trajectory.astar import Plan, Workspace, nearest_open, plan
from edge.trajectory.costmap import OCCUPIED, CostMap, from_occupancy, from_weights
from edge.trajectory.smoothing import line_is_free, smooth

ESCAPE_M = 0.6
"""A robot that stands closer to something than it may drive begins at the nearest cell so near."""
ASIDE = 5
"""Ground outside the regions that were chosen costs so many times as much as within them."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground of a scene for a robot of some size.

    Open is what was seen free or belongs to a region, and is far enough from what is occupied.

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
        clearance_m: of an open cell's centre from every occupied cell's: the robot's radius, and
            what is left beside it.
    """
    occupancy, regions = scene.occupancy, scene.regions_grid
    # LiDAR leaves cells between its rings that nothing hit; a region reaches over them.
    known = np.where((occupancy.cells < 0) & (regions.cells > 0), np.int8(0), occupancy.cells)
    grid = replace(occupancy, cells=known)
    costmap = from_occupancy(grid, clearance_m=clearance_m, unknown_cost=None)
    unoccupied = from_weights(replace(grid, cells=(known < OCCUPIED).astype(np.uint8)))
    reachable = _reachable(costmap, scene.pose.x_m, scene.pose.y_m)
    return Ground(scene, costmap, unoccupied, reachable)


def _reachable(costmap: CostMap, x_m: float, y_m: float) -> np.ndarray:
    """(h, w) bool: open and connected with a point; all False where nothing near it is open."""
    cell = costmap.cell_of(x_m, y_m)
    begin = None if cell is None else nearest_open(costmap, cell, (x_m, y_m), ESCAPE_M)
    if begin is None:
        return np.zeros(costmap.grid.cells.shape, bool)
    # A* cuts no corner, so what it reaches is connected by sides.
    opened = (costmap.weight != 0).view(np.uint8)
    _, parts = cv2.connectedComponents(opened, connectivity=4, ltype=cv2.CV_32S)
    return (parts == parts[begin])[1:-1, 1:-1]


def footprint_m(half_m: np.ndarray, heading_rad: float, angle_rad: float) -> float:
    """How far a box reaches from its middle in a direction: its support function.

    Args:
        half_m: (2,) half its length and width.
    """
    turn = angle_rad - heading_rad
    return abs(math.cos(turn)) * float(half_m[0]) + abs(math.sin(turn)) * float(half_m[1])
