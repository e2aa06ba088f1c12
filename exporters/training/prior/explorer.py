"""Simulated robot that explores a house on its plan, for the training data of the prior.

It is rough on purpose: its pose and map are perfect, and it has no false detections. A camera of 75
degrees maps up to 5 m. An object's detection range depends on its size. The probability of
detection falls from 0.9 nearby to 0.6 at the end of the range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from edge.geometry import Grid
from edge.jit import jit
from edge.mapping import regions
from edge.mission.planning import distances as dist
from exporters.training.prior.house import CELL_M, HousePlan

HFOV_RAD = math.radians(75.0)
MAP_RANGE_M = 5.0
"""Range of the camera for the map."""
LOOK_EVERY_M = 0.25
"""Driven distance between two images ahead."""
TURN_EVERY_M = 2.0
"""Driven distance between two images all around."""
GAIN_RANGE_M = 4.0
"""Range in which unknown area counts for a frontier."""
_NEAR, _FAR = 0.9, 0.6  # probability of detection nearby, and at the end of an object's range
_BODY_M = 0.2  # radius of the robot
_MIN_CELLS = 3  # smallest size of a frontier
_BLOCK_CELLS = 12  # side of a block; a frontier has one target cell in each block
WALL_GAP_M = 0.15
"""Walls nearer than this to an object's side do not hide it: it may stand at the wall."""


@dataclass(frozen=True, slots=True, eq=False)
class Frontiers:
    """Reachable frontiers: places next to unknown floor.

    Attributes:
        cell: (n, 2) int64, row and column of a cell to drive to.
        xy_m: (n, 2) float32, its centre, in metres from the grid's corner.
        path_m: (n,) float64, driving distance.
        area_m2: (n,) float64, visible unknown area.
    """

    cell: np.ndarray
    xy_m: np.ndarray
    path_m: np.ndarray
    area_m2: np.ndarray


class Explorer:
    """A robot in an unknown house.

    Attributes:
        known: (h, w) bool, cells that it has mapped.
        object_m: (n, 2) float32, the plan's objects, in metres from the grid's corner.
        seen: (n,) bool, detected objects.
        seen_m: (n, 2) float32, visible surface of each detected object, in metres from the grid's
            corner.
    """

    def __init__(self, plan: HousePlan, cell: tuple[int, int], random: np.random.Generator) -> None:
        self.plan, self._random = plan, random
        h, w = plan.wall.shape
        self.known = np.zeros((h, w), np.bool_)
        self.seen = np.zeros(len(plan.word), np.bool_)
        self.object_m = (plan.xy_m - plan.origin_xy_m).astype(np.float32)
        self.seen_m = np.zeros((len(plan.word), 2), np.float32)
        self._since_turn_m = 0.0
        self._cell = cell
        body = int(_BODY_M / CELL_M)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * body + 1, 2 * body + 1))
        self._standable = ~cv2.dilate(plan.closed.astype(np.uint8), disc).astype(bool)
        self._standable[cell] = True
        # Output and work arrays of `dist.wavefront`.
        self._distance = np.empty((h, w), np.int32)
        self._buckets = np.empty(64, np.int32)
        self._queue = np.empty((2, 8 * h * w + 1), np.int32)
        self.look(None)

    def look(self, yaw_rad: float | None) -> None:
        """Map and detect everything in view; None for all around."""
        y, x = self._cell
        half = math.pi if yaw_rad is None else 0.5 * HFOV_RAD
        reveal(self.plan.wall, y, x, yaw_rad or 0.0, half, MAP_RANGE_M / CELL_M, self.known)
        draws = self._random.random(len(self.seen))
        detect(
            self.plan.wall, (x + 0.5) * CELL_M, (y + 0.5) * CELL_M, yaw_rad or 0.0, half, CELL_M,
            self.object_m, self.plan.half_m, self.plan.range_m, draws, _NEAR, _FAR,
            self.seen, self.seen_m,
        )  # fmt: skip

    def frontiers(self) -> Frontiers:
        """Return the current frontiers."""
        walkable = self.known & self._standable
        self._measure_distances(walkable)
        reached = self._distance < dist.UNREACHED
        unknown = (~self.known).astype(np.uint8)
        edge = reached & (cv2.dilate(unknown, np.ones((3, 3), np.uint8)) > 0)
        edge[self._cell] = False  # the robot stands there already
        cells = _targets(edge)
        area_m2 = np.zeros(len(cells))
        count_unknown_in_sight(self.known, self.plan.wall, cells, GAIN_RANGE_M / CELL_M, area_m2)
        area_m2 *= CELL_M**2
        path = self._distance[cells[:, 0], cells[:, 1]] / dist.STRAIGHT * CELL_M
        xy = ((cells[:, ::-1] + 0.5) * CELL_M).astype(np.float32)
        kept = area_m2 > 0
        return Frontiers(cells[kept], xy[kept], path[kept], area_m2[kept])

    def drive(self, goal: np.ndarray, most_m: float) -> None:
        """Drive up to `most_m` towards a cell of `frontiers`, and take images on the way.

        The images show the view ahead and, every `TURN_EVERY_M` and at the goal, all around.
        """
        path = trace_path(self._distance, goal[0], goal[1])
        driven_m, next_look_m = 0.0, LOOK_EVERY_M
        for y, x in path[1:]:
            step = CELL_M * math.hypot(y - self._cell[0], x - self._cell[1])
            yaw = math.atan2(y - self._cell[0], x - self._cell[1])
            self._cell = (int(y), int(x))
            driven_m += step
            self._since_turn_m += step
            if self._since_turn_m >= TURN_EVERY_M:
                self.look(None)
                self._since_turn_m = 0.0
            elif driven_m >= next_look_m:
                self.look(yaw)
                next_look_m += LOOK_EVERY_M
            if driven_m >= most_m:
                return
        self.look(None)

    def wall_grid(self) -> Grid:
        """Return the known walls and floor in the form of `regions.coarse_grid`."""
        cells = np.where(self.plan.wall, regions.WALL, regions.OPEN).astype(np.uint8)
        cells[~self.known] = regions.UNKNOWN
        return Grid(cells, (0.0, 0.0), CELL_M)

    def _measure_distances(self, walkable: np.ndarray) -> None:
        """Write the cost from the robot to each walkable cell into `_distance`."""
        # `FREE` (1) or `CLOSED` (0); the border is closed, as `wavefront` requires.
        state = walkable.astype(np.uint8)
        state[0, :] = state[-1, :] = state[:, 0] = state[:, -1] = dist.CLOSED
        state[self._cell] = dist.FREE
        # Costs of a straight and of a diagonal step, the same for all states of a cell.
        step = np.array([[dist.STRAIGHT] * 3, [dist.DIAGONAL] * 3], np.int32)
        start = np.array([[self._cell[0] * state.shape[1] + self._cell[1], 0]], np.int64)
        dist.wavefront(state, step, start, self._distance, self._buckets, self._queue)


def paths_m(plan: HousePlan, cell: tuple[int, int]) -> np.ndarray:
    """Return the driving distance from a cell to all others in a known house: (h, w) float64."""
    explorer = Explorer(plan, cell, np.random.default_rng(0))
    explorer._measure_distances(explorer._standable)
    out = explorer._distance / dist.STRAIGHT * CELL_M
    out[explorer._distance == dist.UNREACHED] = np.inf
    return out


def _targets(edge: np.ndarray) -> np.ndarray:
    """Return one cell for each block of each cluster of frontier cells: (n, 2) int64.

    It is the cell nearest to the middle of the cluster's cells in the block.
    """
    _, label = cv2.connectedComponents(edge.astype(np.uint8), connectivity=8)
    y, x = np.nonzero(edge)
    # A number for each cluster and block; no house has 64 blocks in a row.
    group = (label[y, x] * 64 + y // _BLOCK_CELLS) * 64 + x // _BLOCK_CELLS
    out = []
    for k in np.unique(group):
        at = np.flatnonzero(group == k)
        if len(at) >= _MIN_CELLS:
            off = (y[at] - y[at].mean()) ** 2 + (x[at] - x[at].mean()) ** 2
            out.append((y[at[off.argmin()]], x[at[off.argmin()]]))
    return np.array(out, np.int64).reshape(-1, 2)


@jit
def reveal(wall, y, x, yaw, half, reach, known):
    """Mark the cells in view as known, walls included.

    The view is from the cell (y, x) towards `yaw`, `half` [rad] to each side, `reach` cells far.
    """
    h, w = wall.shape
    rays = int(half / 0.004)  # less than half a cell apart at the end of the range
    for k in range(rays + 1):
        a = yaw - half + 2.0 * half * k / rays
        dy, dx = math.sin(a), math.cos(a)
        for s in range(int(reach) + 1):
            r, c = math.floor(y + 0.5 + s * dy), math.floor(x + 0.5 + s * dx)
            if not (0 <= r < h and 0 <= c < w):
                break
            known[r, c] = True
            if wall[r, c]:
                break


@jit
def is_clear(wall, x, y, to_x, to_y, short, cell_m):
    """Return True if no wall is between two points [m], up to `short` [m] before the second."""
    length = math.hypot(to_x - x, to_y - y)
    steps = int((length - short) / (0.5 * cell_m))
    for k in range(1, steps):
        f = 0.5 * k * cell_m / length
        r, c = math.floor((y + f * (to_y - y)) / cell_m), math.floor((x + f * (to_x - x)) / cell_m)
        if wall[r, c]:
            return False
    return True


@jit
def detect(
    wall, x, y, yaw, half, cell_m, object_m, half_m, range_m, draws, near, far, seen, seen_m
):  # fmt: skip
    """Mark the objects that are detected from x, y [m], and store their visible side.

    Of n objects, `object_m` (n, 2), `half_m` (n,) and `range_m` (n,) are as in `Explorer` and
    `HousePlan`. The view is `half` [rad] to each side of `yaw`.

    `draws` (n,) are random numbers in [0, 1). `near` and `far` are the probabilities of detection
    nearby and at the end of an object's range. `seen` and `seen_m` are changed.
    """
    for i in range(len(seen)):
        dx, dy = object_m[i, 0] - x, object_m[i, 1] - y
        d = math.hypot(dx, dy)
        if seen[i] or d > range_m[i] or draws[i] > near + (far - near) * d / range_m[i]:
            continue
        turn = (math.atan2(dy, dx) - yaw + math.pi) % (2.0 * math.pi) - math.pi
        if abs(turn) > half or not is_clear(
            wall, x, y, object_m[i, 0], object_m[i, 1], half_m[i] + WALL_GAP_M, cell_m
        ):
            continue
        seen[i] = True
        f = max(d - half_m[i], 0.0) / max(d, 1e-6)
        seen_m[i, 0], seen_m[i, 1] = x + f * dx, y + f * dy


@jit
def count_unknown_in_sight(known, wall, cells, reach, out):
    """Count the unknown cells in sight of each cell, up to `reach` cells away, into `out`.

    Known walls block the view. `cells` is (n, 2) row and column, `out` (n,) float64, zeros.
    """
    h, w = known.shape
    stamp = np.full((h, w), -1, np.int32)  # last of `cells` that has counted a cell
    for i in range(len(cells)):
        for k in range(180):
            a = 2.0 * math.pi * k / 180
            dy, dx = math.sin(a), math.cos(a)
            for s in range(1, int(reach) + 1):
                r = math.floor(cells[i, 0] + 0.5 + s * dy)
                c = math.floor(cells[i, 1] + 0.5 + s * dx)
                if not (0 <= r < h and 0 <= c < w) or (known[r, c] and wall[r, c]):
                    break
                if not known[r, c] and stamp[r, c] != i:
                    stamp[r, c] = i
                    out[i] += 1.0


@jit
def trace_path(distance, y, x):
    """Return the path from the cell with distance 0 to (y, x): (m, 2) int64, row and column."""
    h, w = distance.shape
    path = [(y, x)]
    while distance[y, x] > 0:
        best, by, bx = distance[y, x], y, x
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                r, c = y + dy, x + dx
                if 0 <= r < h and 0 <= c < w and distance[r, c] < best:
                    best, by, bx = distance[r, c], r, c
        if by == y and bx == x:
            break
        y, x = by, bx
        path.append((y, x))
    out = np.empty((len(path), 2), np.int64)
    for k in range(len(path)):
        out[k, 0], out[k, 1] = path[len(path) - 1 - k]
    return out
