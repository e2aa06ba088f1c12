"""Shortest paths over a cost map: A* with reusable arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from edge.trajectory import kernels
from edge.trajectory.costmap import CostMap

Reason = Literal[
    "",
    "start outside the map",
    "goal outside the map",
    "start blocked",
    "goal blocked",
    "unreachable",
    "cost overflow",
]


@dataclass(frozen=True, slots=True, eq=False)
class GridPath:
    """A path, or the reason why there is none.

    Attributes:
        path_m: (n, 2) float64 in `map`, from the start to the goal; (0, 2) without a path.
        cost_m: cost of the path in metres of free ground; inf without a path.
        reason: empty if there is a path.
        expansions: number of cells that the search expanded.
        escape_m: distance from a start in a blocked cell to the free cell where the search began; 0
            if the start was in a free cell.
    """

    path_m: np.ndarray
    cost_m: float
    reason: Reason = ""
    expansions: int = 0
    escape_m: float = 0.0

    @property
    def ok(self) -> bool:
        """True if there is a path."""
        return not self.reason


def _no_path(reason: Reason, expansions: int = 0) -> GridPath:
    return GridPath(np.empty((0, 2)), math.inf, reason, expansions)


@dataclass(slots=True, eq=False)
class Workspace:
    """Arrays of the search. They grow to the largest map so far. Use one workspace per thread.

    Between searches every entry of `g` is UNSEEN and every bucket is empty. A search clears only
    the cells that it touched, so a short path on a large map costs as little as on a small one.

    Attributes:
        g: (n,) int32, twice the cost from the start to each cell; see `kernels.search`.
        head: (BUCKETS,) int32, newest entry of each bucket in `pool`; -1: the bucket is empty.
        pool: (m,) int64, entries of the queue; doubled when it is full.
        path: (k,) int32, flat indices of the path; doubled when it is too short.
        out: (3,) int64: number of expansions, lowest and highest flat index that was expanded.
        width: cells in a row of the map, border included.
        tables: three tables of the steps by direction; see `kernels.step_tables`.
    """

    g: np.ndarray = field(default_factory=lambda: np.empty(0, np.int32))
    head: np.ndarray = field(default_factory=lambda: np.full(kernels.BUCKETS, -1, np.int32))
    pool: np.ndarray = field(default_factory=lambda: np.empty(1 << 12, np.int64))
    path: np.ndarray = field(default_factory=lambda: np.empty(1 << 12, np.int32))
    out: np.ndarray = field(default_factory=lambda: np.zeros(3, np.int64))
    width: int = 0
    tables: tuple[np.ndarray, np.ndarray, np.ndarray] = field(
        default_factory=lambda: kernels.step_tables(0)
    )

    def fit(self, cells: int, width: int) -> None:
        """Prepare the arrays for a map of this size."""
        if self.g.size < cells:
            self.g = np.full(cells, kernels.UNSEEN, np.int32)
        if self.width != width:
            self.width, self.tables = width, kernels.step_tables(width)

    def search(self, costmap: CostMap, start: int, goal: int) -> tuple[int, np.ndarray, int]:
        """Return (status, flat indices of the path from the goal back to the start, expansions)."""
        weight, width = costmap.weight.ravel(), costmap.width
        self.fit(weight.size, width)
        # A bucket holds keys that differ by less than the cheapest step.
        shift = max(kernels.STRAIGHT * costmap.min_weight, 1).bit_length() - 1
        # The largest step must fit into the ring of buckets, so widen the buckets until it does.
        reach = kernels.DIAGONAL * (255 + costmap.min_weight)
        while reach >> shift > kernels.BUCKETS - 3:
            shift += 1
        while True:
            status = kernels.search(
                weight, width, start, goal, costmap.h_weight, shift,
                self.g, self.head, self.pool, *self.tables, self.out,
            )  # fmt: skip
            expansions = int(self.out[0])
            length = 0
            if status == kernels.FOUND:
                length = kernels.backtrack(weight, start, goal, self.g, *self.tables, self.path)
                while length < 0:
                    self.path = np.empty(2 * self.path.size, np.int32)
                    length = kernels.backtrack(weight, start, goal, self.g, *self.tables, self.path)
            self._clear_touched(int(self.out[1]), int(self.out[2]), weight.size)
            if status != kernels.POOL_FULL:
                return status, self.path[:length], expansions
            self.pool = np.empty(2 * self.pool.size, np.int64)

    def _clear_touched(self, lowest: int, highest: int, cells: int) -> None:
        """Clear the expanded cells (flat indices) and their neighbours; empty the queue."""
        margin = self.width + 1
        self.g[max(lowest - margin, 0) : min(highest + margin + 1, cells)] = kernels.UNSEEN
        self.head.fill(-1)


def plan(
    costmap: CostMap,
    start_xy_m: tuple[float, float],
    goal_xy_m: tuple[float, float],
    workspace: Workspace | None = None,
    *,
    escape_m: float = 0.6,
) -> GridPath:
    """Find the cheapest path between two points, 8-connected, without cutting corners.

    Entering a cell costs its weight times the length of the step. The cost is within 0.1 % of the
    optimum, because steps are multiples of 1/29 cell.

    Args:
        costmap: the weights.
        start_xy_m: (x, y) in `map`.
        goal_xy_m: (x, y) in `map`.
        workspace: arrays to reuse; None makes new ones.
        escape_m: limit of `GridPath.escape_m`: if the start's cell is blocked, the search begins at
            the nearest free cell within this distance, and the path leads straight to that cell.

    Returns:
        The path. Without a path, `GridPath.ok` is False and `GridPath.reason` gives the cause.

    Example:
        >>> from edge.geometry import Grid
        >>> from edge.trajectory.costmap import from_occupancy
        >>> free = Grid(np.zeros((20, 20), np.int8), (0.0, 0.0), 0.1)
        >>> found = plan(from_occupancy(free), (0.25, 0.25), (1.75, 0.25))
        >>> found.ok, round(found.cost_m, 2)
        (True, 1.5)
    """
    workspace = workspace or Workspace()
    start, goal = costmap.cell_of(*start_xy_m), costmap.cell_of(*goal_xy_m)
    if start is None:
        return _no_path("start outside the map")
    if goal is None:
        return _no_path("goal outside the map")
    if costmap.weight[goal] == 0:
        return _no_path("goal blocked")
    begin = start if costmap.weight[start] else nearest_free(costmap, start, start_xy_m, escape_m)
    if begin is None:
        return _no_path("start blocked")
    width = costmap.width
    status, flat, expansions = workspace.search(
        costmap, begin[0] * width + begin[1], goal[0] * width + goal[1]
    )
    if status != kernels.FOUND:
        reason: Reason = "unreachable" if status == kernels.UNREACHABLE else "cost overflow"
        return _no_path(reason, expansions)
    return _found(costmap, flat[::-1], start_xy_m, goal_xy_m, begin != start, expansions)


def _found(
    costmap: CostMap,
    flat: np.ndarray,
    start_xy_m: tuple[float, float],
    goal_xy_m: tuple[float, float],
    escaped: bool,
    expansions: int,
) -> GridPath:
    """Convert the path to metres: cell centres, with the exact start and goal at its ends.

    Args:
        costmap: the weights.
        flat: (n,) flat indices of the path's cells, the start first.
        start_xy_m: the exact start.
        goal_xy_m: the exact goal.
        escaped: the search began at another cell than that of the start.
        expansions: number of cells that the search expanded.
    """
    rows, columns = np.divmod(flat.astype(np.int64), costmap.width)
    path = costmap.metres_of(np.stack([columns + 0.5, rows + 0.5], axis=1))
    cost = path_cost_m(costmap, path)
    escape = 0.0
    if escaped:
        escape = math.dist(path[0], start_xy_m)
        path = np.concatenate([[start_xy_m], path])
    else:
        path[0] = start_xy_m
    if len(path) > 1:
        path[-1] = goal_xy_m
    else:
        path = np.array([start_xy_m, goal_xy_m])
    return GridPath(path, cost, "", expansions, escape)


def path_cost_m(costmap: CostMap, path_m: np.ndarray) -> float:
    """Return the cost of a path in metres of free ground, as the search counts it.

    Args:
        costmap: the weights.
        path_m: (n, 2) cell centres, each a neighbour of the last in the 8-connected grid.
    """
    if len(path_m) < 2:
        return 0.0
    cells = costmap.grid_of(path_m[1:]).astype(np.int64)
    steps = np.hypot(*np.diff(path_m, axis=0).T)
    return float(steps @ costmap.weight[cells[:, 1], cells[:, 0]]) / costmap.unit


def nearest_free(
    costmap: CostMap, cell: tuple[int, int], xy_m: tuple[float, float], within_m: float
) -> tuple[int, int] | None:
    """Return (row, column) of the free cell with the nearest centre; None beyond `within_m`."""
    reach = math.ceil(within_m / costmap.grid.resolution_m)
    row, column = max(cell[0] - reach, 0), max(cell[1] - reach, 0)
    window = costmap.weight[row : cell[0] + reach + 1, column : cell[1] + reach + 1]
    rows, columns = np.nonzero(window)
    if not len(rows):
        return None
    centres = costmap.metres_of(np.stack([columns + column + 0.5, rows + row + 0.5], axis=1))
    distance = np.hypot(*(centres - np.asarray(xy_m)).T)
    k = int(np.argmin(distance))
    if distance[k] > within_m:
        return None
    return int(rows[k]) + row, int(columns[k]) + column
