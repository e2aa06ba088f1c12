"""Driving distances between the objects of a mission, on the occupancy map.

The distances are approximate: a 0.2 m grid and one wavefront per object are enough to compare
objects. The computation takes tens of milliseconds on a large map, so it runs in the background.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge.geometry import Grid
from edge.jit import jit

# Integer costs of a step to a neighbour: 17/12 is sqrt(2) within 0.2 %.
STRAIGHT, DIAGONAL = 12, 17
# States of a cell of the search; a closed one has an obstacle.
CLOSED, FREE, UNKNOWN = 0, 1, 2
UNREACHED = np.int32(2**31 - 1)
"""Cost of a cell without a path."""
_OCCUPIED = 100  # value of an obstacle in the map
_UNKNOWN_COST = 3.0  # cost of a metre over unknown cells, in metres
_SNAP_M = 1.2  # largest distance from an object, or from the robot, to its nearest cell
_CELL_M = 0.2  # approximate cell size of the search; at least the map's cell size is used


def distances(
    snapshot: Grid, robot_xy_m: tuple[float, float], positions: Sequence[np.ndarray]
) -> np.ndarray:
    """Return `MissionKnowledge.distance_m`: driving distances from objects and robot to objects.

    Paths are the shortest 8-connected ones without cutting corners. A path to an object ends at the
    free cell nearest to the object, within `_SNAP_M`. It may also end at another cell around the
    object that is connected to the nearest cell; the extra distance to the object then counts as
    driven. So an object at a wall is not reached from the next room. Unknown cells are used if no
    cell nearby is free.

    Args:
        snapshot: the map: -1 unknown, 0 free, 100 obstacle, 1 … 99 too near to an obstacle for
            the robot.
        robot_xy_m: position of the robot in `map`.
        positions: for each object of the mission (m, 2) float64, its known instances in `map`;
            (0, 2) for none. The nearest instance counts.

    Returns:
        (k + 1, k) float64 for k = len(positions), last row from the robot. 0 from an object to
        itself. inf if there is no path, no instance, or no cell near the instance that the robot
        may enter.

    Example:
        >>> grid = Grid(np.zeros((20, 20), np.int8), (0.0, 0.0), 0.2)
        >>> distances(grid, (0.5, 0.5), [np.array([[2.5, 0.5]])]).round(1).tolist()
        [[0.0], [2.0]]
    """
    factor = max(1, int(_CELL_M / snapshot.resolution_m + 1e-6))
    side_m = factor * snapshot.resolution_m
    height, width = (-(-side // factor) for side in snapshot.cells.shape)  # rounded up
    # A closed border of one cell saves bounds checks in the wavefront.
    state = np.zeros((height + 2, width + 2), np.uint8)
    coarsen(snapshot.cells, factor, state)
    x_m, y_m = snapshot.origin_xy_m
    # The grid of the search; each of its cells is a block of cells of the map.
    blocks, radius = Grid(state, (x_m - side_m, y_m - side_m), side_m), _SNAP_M / side_m
    ends = [_path_ends(state, blocks.to_cells(np.reshape(p, (-1, 2))), radius) for p in positions]
    robot = nearest_cell(state, *blocks.to_cells(robot_xy_m), radius)
    start = np.array([[robot, 0]] if robot >= 0 else [], np.int64).reshape(-1, 2)
    weight = np.array([0, 1.0, _UNKNOWN_COST])  # by state of the cell
    step = np.rint(np.outer([STRAIGHT, DIAGONAL], weight)).astype(np.int32)
    return _cost_matrix(state, step, ends, [*ends, start]) / STRAIGHT * side_m


def _cost_matrix(
    state: np.ndarray, step: np.ndarray, ends: list[np.ndarray], starts: list[np.ndarray]
) -> np.ndarray:
    """Return the costs from each start set to each object: (len(starts), k) float64.

    Args:
        state: (h, w) uint8, see `coarsen`.
        step: (2, 3) int32, see `wavefront`.
        ends: for each object (m, 2) int64: cells and extra costs at the end of a path.
        starts: the start sets, like `ends`: the objects, then the robot.
    """
    out = np.full((len(starts), len(ends)), np.inf)
    largest = max(step.max(), *(cells[:, 1].max(initial=0) for cells in starts))
    buckets = np.empty(1 << int(largest).bit_length(), np.int32)  # a power of 2 above all costs
    queue = np.empty((2, 8 * state.size + max(len(cells) for cells in starts)), np.int32)
    distance = np.empty(state.shape, np.int32)
    for i, begin in enumerate(starts):
        wavefront(state, step, begin, distance, buckets, queue)
        for j, cells in enumerate(ends):
            costs = distance.ravel()[cells[:, 0]]
            reached = costs != UNREACHED
            if reached.any():
                out[i, j] = 0.0 if begin is cells else (costs + cells[:, 1])[reached].min()
    return out


def _path_ends(state: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Return the cells at which any of some points is reached: (m, 2) int64, see `around`.

    Args:
        state: (h, w) uint8, see `coarsen`.
        points: (n, 2) float64 in cells.
        radius: largest distance to the nearest cell, in cells.
    """
    found = [np.zeros((0, 2), np.int64)]
    for x, y in points.tolist():
        cell = nearest_cell(state, x, y, radius)
        if cell >= 0:
            found.append(around(state, x, y, cell))
    return np.concatenate(found)


@jit
def coarsen(cells, factor, state):
    """Write the states of blocks of cells: closed if one is an obstacle, else free if one is free.

    An obstacle closes every block that it touches, so walls have no gaps. A cell that is only near
    an obstacle closes a block only if all its cells are such, so doors stay open.

    Args:
        cells: (h, w) int8, see `distances`.
        factor: side of a block in cells.
        state: (ceil(h / factor) + 2, ceil(w / factor) + 2) uint8; its interior is written.
    """
    h, w = cells.shape
    for row in range(state.shape[0] - 2):
        for col in range(state.shape[1] - 2):
            value = CLOSED  # -1 after an obstacle, so that no other cell opens the block again
            for y in range(row * factor, min((row + 1) * factor, h)):
                for x in range(col * factor, min((col + 1) * factor, w)):
                    cell = cells[y, x]
                    if cell == 0 and value != -1:
                        value = FREE
                    elif cell < 0 and value == CLOSED:
                        value = UNKNOWN
                    elif cell >= _OCCUPIED:
                        value = -1
            state[row + 1, col + 1] = max(value, CLOSED)


@jit
def nearest_cell(state, x, y, radius):
    """Return the enterable cell whose centre is nearest to a point; free cells before unknown ones.

    Args:
        state: (h, w) uint8.
        x: position in cells; cell (r, c) spans [c, c + 1) x [r, r + 1).
        y: position in cells.
        radius: largest distance in cells.

    Returns:
        Flat index of the cell; -1 if there is none.
    """
    h, w = state.shape
    best, found, found_state = radius * radius, -1, UNKNOWN
    if not (-radius <= x <= w + radius and -radius <= y <= h + radius):
        return found  # far outside, or NaN
    for row in range(max(int(y - radius), 0), min(int(y + radius) + 2, h)):
        for col in range(max(int(x - radius), 0), min(int(x + radius) + 2, w)):
            here = state[row, col]
            d2 = (col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2
            if here == CLOSED or here > found_state or d2 > radius * radius:
                continue
            if here < found_state or d2 < best or found < 0:
                best, found, found_state = d2, row * w + col, here
    return found


@jit
def around(state, x, y, cell):
    """Return the cells around a point that are connected to the nearest cell.

    They have the state of that cell and are within sqrt(2) times its distance plus two cells. This
    radius passes the corners of a square object. Connections are along the axes.

    Args:
        state: (h, w) uint8.
        x: position of the point in cells.
        y: position of the point in cells.
        cell: flat index of the nearest cell.

    Returns:
        (m, 2) int64: flat indices, `cell` first, and their additional distance from the point as
        a cost (STRAIGHT for the side of a cell).
    """
    h, w = state.shape
    row, col = cell // w, cell % w
    kind = state[row, col]
    least = math.sqrt((col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2)
    radius = math.sqrt(2.0) * least + 2.0
    y0, x0 = max(int(y - radius) - 1, 0), max(int(x - radius) - 1, 0)
    y1, x1 = min(int(y + radius) + 2, h), min(int(x + radius) + 2, w)
    seen = np.zeros((y1 - y0, x1 - x0), np.bool_)
    out = np.zeros((seen.size, 2), np.int64)
    out[0, 0], n, done = cell, 1, 0
    seen[row - y0, col - x0] = True
    while done < n:
        row, col = out[done, 0] // w, out[done, 0] % w
        done += 1
        for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = row + dy, col + dx
            if not (y0 <= r < y1 and x0 <= c < x1) or seen[r - y0, c - x0]:
                continue
            distance = math.sqrt((c + 0.5 - x) ** 2 + (r + 0.5 - y) ** 2)
            if state[r, c] == kind and distance <= radius:
                seen[r - y0, c - x0] = True
                out[n, 0], out[n, 1] = r * w + c, round((distance - least) * STRAIGHT)
                n += 1
    return out[:n]


@jit
def wavefront(state, step, starts, distance, buckets, queue):
    """Write Dijkstra's distances from several cells, with one bucket per cost (Dial's algorithm).

    A step costs `step` of the state of the entered cell. Costs in the queue span fewer values than
    there are buckets, so a bucket never holds two costs.

    Args:
        state: (h, w) uint8 with a closed border.
        step: (2, 3) int32, cost of a straight and of a diagonal step, by the state of the cell.
        starts: (m, 2) int64: flat indices of cells that are not closed, and their initial costs.
        distance: (h, w) int32 output; UNREACHED if there is no path.
        buckets: int32 scratch; its length is a power of 2 above all step and initial costs.
        queue: (2, 8 h w + m) int32 scratch: cells, and the next entry of a bucket.
    """
    width = state.shape[1]
    cells, nearest = state.ravel(), distance.ravel()
    nearest[:] = UNREACHED
    buckets[:] = -1
    moves = np.array([1, width, -1, -width, 1 + width, width - 1, -1 - width, 1 - width])
    queued = 0
    for k in range(starts.shape[0]):
        cell, cost = starts[k]
        if cost < nearest[cell]:
            nearest[cell] = cost
            queue[0, queued], queue[1, queued] = cell, buckets[cost]
            buckets[cost] = queued
            queued += 1
    mask, level, idle = buckets.size - 1, 0, 0
    while idle < buckets.size:
        slot = level & mask
        idle = idle + 1 if buckets[slot] < 0 else 0
        while buckets[slot] >= 0:
            entry = buckets[slot]
            buckets[slot] = queue[1, entry]
            cell = queue[0, entry]
            if nearest[cell] != level:
                continue  # a shorter path was found after this one was queued
            for m in range(8):
                near = cell + moves[m]
                kind = cells[near]
                if kind == CLOSED:
                    continue
                diagonal = m >= 4
                if diagonal and (
                    cells[cell + moves[m - 4]] == CLOSED
                    or cells[cell + moves[(m - 3) % 4]] == CLOSED
                ):
                    continue  # no robot cuts a corner
                cost = level + step[1 if diagonal else 0, kind]
                if cost < nearest[near]:
                    nearest[near] = cost
                    queue[0, queued], queue[1, queued] = near, buckets[cost & mask]
                    buckets[cost & mask] = queued
                    queued += 1
        level += 1
