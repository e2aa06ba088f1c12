"""A* on a weighted grid: the search kernel.

`edge.trajectory.astar` calls it. A cell is *free* if its weight is above 0, else *blocked*.

Weights are integers. A step costs the weight of the entered cell times the length of the step. So
the key of a cell in the queue (its cost from the start plus the heuristic) is an integer too, and
the queue is a ring of buckets instead of a heap. Two properties make the search fast:

- Entering a cell costs the same weight from every side. If a cell was entered from its parent, and
  the parent also touches a neighbour of it by a step that is not longer, then the way through the
  cell cannot be cheaper. Each cell therefore expands only five neighbours: those within 90 degrees
  of the direction in which it was entered.
- A bucket is a stack. Of two entries for a cell, the newer one has the smaller key and is popped
  first; the older one then finds the cell expanded, and is ignored. An expanded cell whose cost
  falls later waits again. This keeps the result exact although a bucket is not sorted.
"""

from __future__ import annotations

import numpy as np
from numba import int64, uint32

from edge.jit import jit

# Step lengths in units of 1/29 cell: 41/29 is sqrt(2) within 0.03 %.
STRAIGHT = 29
DIAGONAL = 41
BUCKETS = 1024  # buckets in the ring of the queue; a power of two
UNSEEN = np.int32(2**31 - 1)  # cost of a cell that the search has not reached
G_LIMIT = 2**30 - 1 - DIAGONAL * 255  # largest cost to which any step can be added
MAX_SIDE = 1 << 14  # largest side of a map, border included: x and y take 14 bits each

FOUND, UNREACHABLE, POOL_FULL, COST_OVERFLOW = 0, 1, 2, 3  # results of `search`

# Directions counter-clockwise from +x: the odd ones are diagonals.
_DX = (1, 1, 0, -1, -1, -1, 0, 1)
_DY = (0, 1, 1, 1, 0, -1, -1, -1)
# A packed cell is, from the lowest bit: x (14 bits), y (14 bits), direction of entry (3 bits).
_XY = (1 << 14) - 1  # mask of x
_CELL = (1 << 28) - 1  # mask of x and y


def step_tables(width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three tables by direction, (8,) each, for a grid of this width.

    They hold the change of the flat index, the change of the packed cell, and twice the step
    length.
    """
    dx, dy = np.array(_DX), np.array(_DY)
    packed = (dy << 14) + dx + (np.arange(8) << 28)
    length = np.where(np.arange(8) % 2 == 0, 2 * STRAIGHT, 2 * DIAGONAL)
    return dy * width + dx, packed, length


@jit
def _heuristic(cell, goal_x, goal_y, h_long, h_short):
    """Return the octile distance times the heuristic's weight.

    The result never exceeds the cost to the goal, so the path that A* finds is the cheapest.
    `h_long` and `h_short` are the costs for each cell of the longer and of the shorter of |dx| and
    |dy|.
    """
    dx = abs((cell & _XY) - goal_x)
    dy = abs(((cell >> 14) & _XY) - goal_y)
    return h_long * max(dx, dy) + h_short * min(dx, dy)


@jit
def search(weight, width, start, goal, h_weight, shift, g, head, pool, offset, packed, length, out):
    """Run A* from `start` to `goal`.

    - `weight`: (n,) uint8, row by row, with a border of zeros; 0 = blocked.
    - `width`: cells in a row, border included; at most MAX_SIDE.
    - `start`, `goal`: flat indices.
    - `h_weight`: weight of the heuristic, at most the smallest weight above 0; 0 = Dijkstra.
    - `shift`: a bucket holds keys that differ by less than 1 << shift.
    - `g`: (n,) int32, all UNSEEN on entry; twice the cost from the start, plus 1 while the cell
      waits to be expanded.
    - `head`: (BUCKETS,) int32, newest entry of each bucket, all -1 on entry.
    - `pool`: (m,) int64, entries: packed cell and direction in the low half, index of the next
      entry of its bucket in the high half. Unused entries form a list too; `unused` is its first.
    - `offset`, `packed`, `length`: `step_tables(width)`.
    - `out`: (3,) int64 output: expansions, lowest and highest flat index that was expanded.

    Returns:
        FOUND, UNREACHABLE, POOL_FULL (run again with a larger pool) or COST_OVERFLOW.
    """
    goal_x, goal_y = goal % width, goal // width
    full, limit = pool.size - 8, 2 * G_LIMIT  # one expansion adds up to 5 entries
    h_long, h_short = STRAIGHT * h_weight, (DIAGONAL - STRAIGHT) * h_weight
    for e in range(pool.size):
        pool[e] = int64(e + 1) << 32
    # The start was not entered from any side: entries for east and west cover all neighbours.
    # Entry 0 has direction 0 and is followed by entry 1, which has direction 4 and is the last.
    cell = ((start // width) << 14) | (start % width)
    bucket = _heuristic(cell, goal_x, goal_y, h_long, h_short) >> shift
    pool[0], pool[1] = cell | (int64(1) << 32), cell | (int64(4) << 28) | (int64(-1) << 32)
    head[bucket & (BUCKETS - 1)] = 0
    g[start] = 1
    unused = int64(2)
    expansions, lo, hi = -1, start, start  # -1: the start is popped twice
    idle = 0  # empty buckets in a row; after `BUCKETS` of them the queue is empty
    status = UNREACHABLE
    while idle < BUCKETS:
        # No entry that is left has a smaller key than the goal, so none leads to it at less cost.
        if g[goal] != UNSEEN and g[goal] >> 1 >> shift < bucket:
            status = FOUND
            break
        slot = uint32(bucket & (BUCKETS - 1))
        entry = int64(head[slot])
        idle = idle + 1 if entry < 0 else 0
        while entry >= 0:
            cell = pool[uint32(entry)]
            head[slot] = cell >> 32
            pool[uint32(entry)] = unused << 32
            unused = entry
            i = ((cell >> 14) & _XY) * width + (cell & _XY)
            g_i = int64(g[uint32(i)])
            # Bit 0 of `g` says that the cell waits. It is cleared in `g`, and stays set in `g_i`,
            # so that the neighbours get it with the cost. The start has two entries; both expand.
            if g_i & 1 or i == start:
                g_i |= 1
                g[uint32(i)] = g_i - 1
                expansions += 1
                lo = min(lo, i)
                hi = max(hi, i)
                d = ((cell >> 28) & 7) + 6  # -2 (mod 8): two directions clockwise from the entry's
                for m in range(5):
                    k = uint32((d + m) & 7)
                    j = uint32(i + offset[k])
                    w = int64(weight[j])
                    g_j = g_i + w * length[k]
                    if (
                        g_j < g[j]
                        and w != 0
                        and (
                            # No cut corners: both cells next to a diagonal step must be free.
                            k & 1 == 0
                            or (
                                weight[uint32(i + offset[uint32((k + 1) & 7)])] != 0
                                and weight[uint32(i + offset[uint32(k - 1)])] != 0
                            )
                        )
                    ):
                        g[j] = g_j
                        entered = (cell & _CELL) + packed[k]
                        f = g_j >> 1
                        if h_weight > 0:
                            f += _heuristic(entered, goal_x, goal_y, h_long, h_short)
                        into = uint32((f >> shift) & (BUCKETS - 1))
                        new = unused
                        unused = pool[uint32(new)] >> 32
                        pool[uint32(new)] = entered | (int64(head[into]) << 32)
                        head[into] = new
                if unused >= full or g_i > limit:
                    status = POOL_FULL if unused >= full else COST_OVERFLOW
                    break
            entry = int64(head[slot])
        if status > UNREACHABLE:
            break
        bucket += 1
    out[0], out[1], out[2] = expansions, lo, hi
    return status


@jit
def backtrack(weight, start, goal, g, offset, packed, length, path):
    """Follow a finished search from the goal back to the start.

    `path` is (m,) int32 output: flat indices, the goal first. The other parameters are as in
    `search`.

    Returns:
        The number of indices, or -1 if `path` is too short.
    """
    i, n = goal, 0
    while True:
        if n == path.size:
            return -1
        path[n] = i
        n += 1
        if i == start:
            return n
        best, best_g = -1, int64(UNSEEN)
        for k in range(8):
            # The step from j to i. g grows along a path, so the loop ends at the start.
            j = i - offset[k]
            if weight[j] == 0 or g[j] == UNSEEN:
                continue
            if k & 1 and (weight[i - offset[(k + 1) & 7]] == 0 or weight[i - offset[k - 1]] == 0):
                continue
            # Without the bit of waiting. `length` is twice the step, as `g` is twice the cost.
            through = (g[j] >> 1) * 2 + length[k] * int64(weight[i])
            if through < best_g:
                best, best_g = j, through
        i = best


@jit
def line_cost(weight, x0, y0, x1, y1):
    """Return the cost of a straight line: the sum over its cells of weight times length inside.

    Args:
        weight: (h, w) uint8 with a border of zeros.
        x0: start of the line in grid coordinates (`CostMap.grid_of`).
        y0: as `x0`.
        x1: end of the line, as `x0`.
        y1: as `x1`.

    Returns:
        The cost in cells, or -1 if the line leaves the map or enters a blocked cell. A line through
        a corner needs both cells next to the corner free.
    """
    rows, columns = weight.shape
    for x, y in ((x0, y0), (x1, y1)):
        if not (0.0 <= x < columns and 0.0 <= y < rows):  # also true for NaN
            return -1.0
    dx, dy = x1 - x0, y1 - y0
    total = np.sqrt(dx * dx + dy * dy)
    column, row = int(x0), int(y0)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    # Fractions of the line at which the next column and row are entered.
    next_x = ((column + (dx > 0)) - x0) / dx if dx != 0 else np.inf
    next_y = ((row + (dy > 0)) - y0) / dy if dy != 0 else np.inf
    done, cost = 0.0, 0.0
    while True:
        if weight[row, column] == 0:
            return -1.0
        ahead = min(next_x, next_y, 1.0)
        cost += weight[row, column] * (ahead - done) * total
        done = ahead
        if done >= 1.0:
            return cost
        corner = abs(next_x - next_y) * total < 1e-9
        if corner and (weight[row, column + step_x] == 0 or weight[row + step_y, column] == 0):
            return -1.0
        if corner or next_x < next_y:
            column += step_x
            next_x += step_x / dx
        if corner or next_y <= done:
            row += step_y
            next_y += step_y / dy


@jit
def shortcut(weight, points, out):
    """Replace parts of a path by straight lines that cost no more.

    Args:
        weight: (h, w) uint8 with a border of zeros.
        points: (n, 2) float64 in grid coordinates, n >= 2.
        out: (n, 2) float64 output, the points that are kept.

    Returns:
        The number of points kept; the first and the last are always among them.
    """
    n = len(points)
    out[0] = points[0]
    kept, anchor = 1, 0
    while anchor < n - 1:
        walked = line_cost(
            weight, points[anchor, 0], points[anchor, 1],
            points[anchor + 1, 0], points[anchor + 1, 1],
        )  # fmt: skip
        best = anchor + 1
        j = anchor + 2
        while j < n and walked >= 0:
            leg = line_cost(weight, points[j - 1, 0], points[j - 1, 1], points[j, 0], points[j, 1])
            line = line_cost(
                weight, points[anchor, 0], points[anchor, 1], points[j, 0], points[j, 1]
            )
            if leg < 0 or line < 0:
                break
            walked += leg
            if line <= walked * 1.001:  # the steps of the search are only exact to 0.1 %
                best = j
            elif j > best + 8:  # eight longer lines in a row failed, so a still longer one will too
                break
            j += 1
        out[kept] = points[best]
        kept += 1
        anchor = best
    return kept


@jit
def polyline_cost(weight, points):
    """Return the sum of `line_cost` over the legs of (n, 2) grid points; -1 if one is blocked."""
    cost = 0.0
    for k in range(len(points) - 1):
        leg = line_cost(weight, points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1])
        if leg < 0:
            return -1.0
        cost += leg
    return cost
