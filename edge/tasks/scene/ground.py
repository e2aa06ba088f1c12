"""Ground that the robot can reach in a scene: distances, lines of sight, stopping points, paths."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene.outline import Outline, outline_of
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.scene.value_map import near_seen, open_cells
from edge.trajectory.astar import GridPath, Workspace, plan
from edge.trajectory.costmap import OCCUPIED, CostMap, from_occupancy, from_weights
from edge.trajectory.smoothing import line_is_free, smooth

ESCAPE_M = 0.6
"""A robot closer to an obstacle than its clearance starts at the nearest open cell within this."""
REACH_M = 5.0
"""The robot is not sent to an object that it cannot come this near to."""
ABOUT_M = 0.35
"""Stopping points count as equally near to an object if their distances differ by at most this.

A robot has reached an object when it stands within 1 m of it. A robot that gets within 0.4 m still
meets this, with some room for errors of the outline and of the controller.
"""
OWN_CELLS = 2.0
"""Occupied cells this close to an object's own cells belong to the object."""
OTHER_GROUND_FACTOR = 5
"""Cost factor of ground outside the regions that were chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class ReachableGround:
    """The ground of a scene for a robot with some clearance; `ground_of` makes it.

    A cell is open as `edge.tasks.scene.value_map.open_cells` defines it.

    Attributes:
        costmap: cells that are not open have weight 0; costs grow towards obstacles.
        unoccupied: weight 0 only at occupied cells, for lines of sight.
        reachable: (h, w) bool, the cells of the scene's grids that are open and connected with the
            robot.
    """

    scene: Scene
    costmap: CostMap
    unoccupied: CostMap
    reachable: np.ndarray
    _costmaps: dict[frozenset[int], CostMap] = field(default_factory=dict)
    _outlines: dict[int, Outline] = field(default_factory=dict)
    _gaps_m: dict[int, np.ndarray] = field(default_factory=dict)  # by object: of each cell
    _workspace: Workspace = field(default_factory=Workspace)

    def is_free(self, x_m: float, y_m: float) -> bool:
        """Return True if the robot can be at a point, and can get there."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        return cell is not None and bool(self.reachable[cell])

    def is_occupied(self, x_m: float, y_m: float) -> bool:
        """Return True if a point of the map is occupied."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        return cell is not None and bool(self.scene.occupancy.cells[cell] > 0)

    def is_unseen(self, x_m: float, y_m: float) -> bool:
        """Return True if a point was never seen, or is outside the map."""
        cell = self.scene.occupancy.cell_of(x_m, y_m)
        if cell is None:
            return True
        return bool(self.scene.occupancy.cells[cell] < 0) and not self.region_at(x_m, y_m)

    def has_line_of_sight(self, a_m: tuple[float, float], b_m: tuple[float, float]) -> bool:
        """Return True if no occupied cell is on the straight line between two points."""
        return line_is_free(self.unoccupied, a_m, b_m)

    def region_at(self, x_m: float, y_m: float) -> int:
        """Return the id of the drivable region at a point; 0 if there is none."""
        cell = self.scene.regions_grid.cell_of(x_m, y_m)
        return 0 if cell is None else int(self.scene.regions_grid.cells[cell])

    def nearest(
        self, x_m: float, y_m: float, within_m: float = math.inf, region: int | None = None
    ) -> tuple[float, float] | None:
        """Return the reachable point nearest to a point: the point itself, or the centre of a cell.

        Args:
            x_m: x of the point in `map`.
            y_m: y of the point in `map`.
            within_m: largest distance.
            region: id of the only region to search; None: anywhere.

        Returns:
            (x_m, y_m); None if nothing is near enough.
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

    def outline(self, obj: SceneObject) -> Outline:
        """Return the outline of an object."""
        if obj.id not in self._outlines:
            self._outlines[obj.id] = outline_of(obj, self.scene.occupancy)
        return self._outlines[obj.id]

    def has_clear_view_of(self, obj: SceneObject, at_m: tuple[float, float]) -> bool:
        """Return True if nothing stands between a point and an object."""
        near_m = self.outline(obj).nearest(at_m)
        margin_m = OWN_CELLS * self.scene.occupancy.resolution_m
        share = 1.0 - margin_m / max(math.dist(at_m, near_m), margin_m)
        (x, y), (nx, ny) = at_m, near_m
        return self.has_line_of_sight(at_m, (x + share * (nx - x), y + share * (ny - y)))

    def stopping_point(
        self, obj: SceneObject, from_m: tuple[float, float]
    ) -> tuple[tuple[float, float] | None, float]:
        """Return where the robot stops at an object if it comes from a point.

        Candidates are reachable points with a clear view of the object, about as near to it as the
        nearest such point (`ABOUT_M`). The candidate nearest to `from_m` wins. If no point has a
        clear view, all near points are candidates. Drivable regions take precedence over other
        ground.

        Returns:
            (x_m, y_m), or None if there is no point within `REACH_M`; and the distance to the
            object, inf if no point is reachable.
        """
        # Short bridges over unseen ground are as good as the regions that they join.
        regions = near_seen(self.scene.regions_grid.cells > 0, self.scene.occupancy.resolution_m)
        regions &= (self.scene.regions_grid.cells > 0) | (self.scene.occupancy.cells < 0)
        on_region = self._stopping_point_on(obj, from_m, self.reachable & regions)
        return on_region if on_region[0] else self._stopping_point_on(obj, from_m, self.reachable)

    def _stopping_point_on(
        self, obj: SceneObject, from_m: tuple[float, float], cells: np.ndarray
    ) -> tuple[tuple[float, float] | None, float]:
        """Do the work of `stopping_point` for some cells, (h, w) bool."""
        if obj.id not in self._gaps_m:
            # 0.7 m may be 0.7000000001 m.
            self._gaps_m[obj.id] = self.outline(obj).gaps_by_cell_m(self.scene.occupancy).round(6)
        by_cell_m = self._gaps_m[obj.id]
        rows, columns = np.nonzero(cells & (by_cell_m <= REACH_M + ABOUT_M))
        gaps_m, centres_m = by_cell_m[rows, columns], self.scene.occupancy.centres_m(rows, columns)
        nearest = self._first_with_view(obj, centres_m, np.argsort(gaps_m, kind="stable"))
        if nearest is None or gaps_m[nearest] > REACH_M:
            return None, float(by_cell_m[cells].min(initial=math.inf))
        nearest_m = float(gaps_m[nearest])
        near = np.flatnonzero(gaps_m <= nearest_m + ABOUT_M)
        away_m = np.hypot(*(centres_m[near] - from_m).T)
        first = self._first_with_view(obj, centres_m, near[np.argsort(away_m, kind="stable")])
        assert first is not None  # `near` is not empty
        x_m, y_m = centres_m[first].tolist()
        return (x_m, y_m), nearest_m

    def _first_with_view(
        self, obj: SceneObject, points_m: np.ndarray, order: np.ndarray
    ) -> int | None:
        """Return the first index in `order` whose point has a clear view of an object.

        If no point has one, return the first index: an object may stand beyond the map, or its foot
        may be hidden.
        """
        for k in order.tolist():
            x_m, y_m = points_m[k].tolist()
            if self.has_clear_view_of(obj, (x_m, y_m)):
                return k
        return int(order[0]) if len(order) else None

    def plan(
        self,
        start_m: tuple[float, float],
        goal_m: tuple[float, float],
        regions: frozenset[int] = frozenset(),
        spacing_m: float = 0.5,
    ) -> GridPath:
        """Find the cheapest path over open ground, straightened.

        Args:
            start_m: (x, y) in `map`.
            goal_m: (x, y) in `map`.
            regions: ids; other ground costs `OTHER_GROUND_FACTOR` times as much. Empty: all ground
                costs the same.
            spacing_m: largest distance between two points.
        """
        costmap = self._costmap(regions)
        found = plan(costmap, start_m, goal_m, self._workspace, escape_m=ESCAPE_M)
        return replace(found, path_m=smooth(costmap, found.path_m, spacing_m))

    def _costmap(self, regions: frozenset[int]) -> CostMap:
        """Return the cost map in which ground outside these regions costs more."""
        if not regions:
            return self.costmap
        if regions not in self._costmaps:
            weights = self.costmap.grid.cells
            other = ~np.isin(self.scene.regions_grid.cells, list(regions))
            raised = np.where(
                other, np.minimum(weights.astype(np.uint16) * OTHER_GROUND_FACTOR, 255), weights
            )
            grid = replace(self.costmap.grid, cells=raised.astype(np.uint8))
            self._costmaps[regions] = from_weights(grid, self.costmap.unit)
        return self._costmaps[regions]


def ground_of(scene: Scene, clearance_m: float) -> ReachableGround:
    """Compute the ground of a scene; `clearance_m` is as in `value_map.closed_cells`."""
    occupancy = scene.occupancy
    is_open = open_cells(occupancy, scene.regions_grid, clearance_m)
    cells = np.where(is_open, np.int8(0), np.int8(OCCUPIED))
    costmap = from_occupancy(replace(occupancy, cells=cells))
    solid = (occupancy.cells < OCCUPIED).astype(np.uint8)
    unoccupied = from_weights(replace(occupancy, cells=solid))
    return ReachableGround(scene, costmap, unoccupied, reachable(is_open, occupancy, scene.pose))


def reachable(is_open: np.ndarray, grid: Grid, pose: SE2) -> np.ndarray:
    """Return the open cells that are connected with the robot's cell, (h, w) bool.

    If the robot's cell is not open, start from the nearest open cell within `ESCAPE_M`. `is_open`
    is (h, w) bool, on the cells of `grid`.
    """
    rows, columns = np.nonzero(is_open)
    away_m = np.hypot(*(grid.centres_m(rows, columns) - (pose.x_m, pose.y_m)).T)
    cell = grid.cell_of(pose.x_m, pose.y_m)
    if cell is None or not len(away_m) or not (is_open[cell] or away_m.min() <= ESCAPE_M):
        return np.zeros(is_open.shape, bool)
    begin = cell if is_open[cell] else (rows[np.argmin(away_m)], columns[np.argmin(away_m)])
    # A* cuts no corners, so cells that it reaches are connected by their sides.
    _, parts = cv2.connectedComponents(is_open.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    return parts == parts[begin]
