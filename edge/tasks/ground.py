"""Where the robot can get to in a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.outline import Outline, outline_of
from edge.tasks.scene import Scene, SceneObject
from edge.tasks.value_map import open_cells
from edge.trajectory.astar import Plan, Workspace, plan
from edge.trajectory.costmap import OCCUPIED, CostMap, from_occupancy, from_weights
from edge.trajectory.smoothing import line_is_free, smooth

ESCAPE_M = 0.6
"""A robot that stands closer to something than it may drive begins at the nearest cell so near."""
REACH_M = 5.0
"""A thing that the robot gets no nearer to is not gone to."""
ABOUT_M = 0.35
"""Points that are farther from a thing by less are about as near to it. A robot has reached what it
stands within 1 m of: this leaves room for one that gets within 0.4 m, for what is seen of a thing's
outline, and for where a controller comes to rest."""
OWN_CELLS = 2.0
"""So many cells before a thing's own, what is occupied is of the thing."""
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
    _outlines: dict[int, Outline] = field(default_factory=dict)
    _workspace: Workspace = field(default_factory=Workspace)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Whether the robot can be there, and get there."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        return cell is not None and bool(self.reachable[cell])

    def is_occupied(self, x_m: float, y_m: float) -> bool:
        """Whether something stands at a point of the map."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        return cell is not None and bool(self.scene.occupancy.cells[cell] > 0)

    def is_unseen(self, x_m: float, y_m: float) -> bool:
        """Whether nobody has seen what is at a point; true outside the map."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        if cell is None:
            return True
        return bool(self.scene.occupancy.cells[cell] < 0) and not self.region_at(x_m, y_m)

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

    def outline(self, thing: SceneObject) -> Outline:
        """What of a thing stands in the way."""
        if thing.id not in self._outlines:
            self._outlines[thing.id] = outline_of(thing, self.scene.occupancy)
        return self._outlines[thing.id]

    def faces(self, thing: SceneObject, at_m: tuple[float, float]) -> bool:
        """Whether nothing stands between a point and a thing."""
        near_m = self.outline(thing).nearest(at_m)
        margin_m = OWN_CELLS * self.scene.occupancy.resolution_m
        share = 1.0 - margin_m / max(math.dist(at_m, near_m), margin_m)
        (x, y), (nx, ny) = at_m, near_m
        return self.sees(at_m, (x + share * (nx - x), y + share * (ny - y)))

    def stop(
        self, thing: SceneObject, from_m: tuple[float, float]
    ) -> tuple[tuple[float, float] | None, float]:
        """Where one who comes from a point stops at a thing.

        Of the reachable points from which nothing stands before it and that are about as near to it
        as the nearest (`ABOUT_M`), the one nearest to where one comes from; where something stands
        before it everywhere, of all that are near. Drivable regions go before other ground.

        Returns:
            (x_m, y_m), None where there is none within `REACH_M`; and how near to the thing one
            gets, inf where one gets nowhere.
        """
        regions = self.scene.regions_grid.cells > 0
        on_region = self._stop(thing, from_m, self.reachable & regions)
        return on_region if on_region[0] else self._stop(thing, from_m, self.reachable)

    def _stop(
        self, thing: SceneObject, from_m: tuple[float, float], among: np.ndarray
    ) -> tuple[tuple[float, float] | None, float]:
        """`stop`, among cells (h, w) bool."""
        centres_m = self.scene.occupancy.centres_m(*np.nonzero(among))
        if not len(centres_m):
            return None, math.inf
        gaps_m = self.outline(thing).gaps_m(centres_m).round(6)  # 0.7 m may be a hair more
        near = np.flatnonzero(gaps_m <= REACH_M + ABOUT_M)
        by_gap = near[np.argsort(gaps_m[near], kind="stable")]
        nearest = self._first_facing(thing, centres_m, by_gap)
        if nearest is None or gaps_m[nearest] > REACH_M:
            return None, float(gaps_m.min())
        nearest_m = float(gaps_m[nearest])
        about = near[gaps_m[near] <= nearest_m + ABOUT_M]
        away_m = np.hypot(*(centres_m[about] - from_m).T)
        first = self._first_facing(thing, centres_m, about[np.argsort(away_m, kind="stable")])
        assert first is not None  # about is not empty
        x_m, y_m = centres_m[first].tolist()
        return (x_m, y_m), nearest_m

    def _first_facing(
        self, thing: SceneObject, points_m: np.ndarray, order: np.ndarray
    ) -> int | None:
        """The first of some indices whose point faces a thing; where none does, the first: a thing
        may stand beyond the map, or behind what hides its foot."""
        for k in order.tolist():
            x_m, y_m = points_m[k].tolist()
            if self.faces(thing, (x_m, y_m)):
                return k
        return int(order[0]) if len(order) else None

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
