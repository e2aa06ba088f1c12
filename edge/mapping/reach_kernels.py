"""Kernels of `TravelCostField`: the wavefront, and queries on a complete field.

A *step* is a straight move by one cell, with cost `STRAIGHT`, or a diagonal one, with cost
`DIAGONAL`. The wavefront takes the queued cells in the order of their cost. A cell that was taken
is *settled*: its cost is final.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge.jit import jit
from edge.mapping.layers import FREE, OCCUPIED, ZONE, bit_get, on_trail
from edge.mapping.points import TALL

# Octile steps as integers: 7 / 5 approximates sqrt 2 (1 % short), so that a few buckets are
# enough for a priority queue (Dial).
STRAIGHT, DIAGONAL = 5, 7
BUCKETS = 8
# For each of the eight neighbours in row order: the two straight ones next to a diagonal one.
_NEXT_TO_DIAGONAL = np.array([[1, 3], [0, 0], [1, 4], [0, 0], [0, 0], [3, 6], [0, 0], [4, 6]])
UNREACHED = np.int32(0)
"""Entry of `Wave.distance` of a cell that the field has not reached."""
# Entries of `Wave.state`: 1 + cost of the cells that are taken now, number of queued cells, squared
# escape radius (-1 if the start is free), storage cell of the start.
_LEVEL, _QUEUED, _ESCAPE2, _START_X, _START_Y = range(5)
# An obstacle this near to a point of an object's surface is the object itself. With more cells, the
# robot would stop behind the wall that the object stands at: noise puts some points into that wall.
_OWN_CELLS = 2


class Wave(NamedTuple):
    """One field and the queue with which it grows.

    Attributes:
        distance: (N, N) int32 by storage cell: 1 + cost of the steps; 0 = not reached.
        bucket: (8, m) int32, queued cells by cost mod 8.
        filled: (8,) int64, number of cells in each bucket.
        bounds: (4,) int64, half-open storage rectangle that was written.
        state: (5,) int64, progress of the field; see `_LEVEL` and the entries after it.
    """

    distance: np.ndarray
    bucket: np.ndarray
    filled: np.ndarray
    bounds: np.ndarray
    state: np.ndarray


@jit
def start_wave(layers, wave, sx, sy, escape_cells):
    """Start an empty field at a storage cell.

    A robot inside the inflation may leave it: within `escape_cells` of the start, every free cell
    can be crossed although it is inflated.
    """
    n = layers.raw.shape[0]
    wave.filled[:] = 0
    wave.state[:] = 0
    wave.state[_LEVEL] = 1
    wave.state[_QUEUED] = 1
    wave.state[_START_X], wave.state[_START_Y] = sx, sy
    free = bit_get(layers.known, sy, sx) and not bit_get(layers.blocked, sy, sx)
    wave.state[_ESCAPE2] = -1 if free else int(escape_cells * escape_cells)
    wave.distance[sy, sx] = 1
    wave.bounds[0], wave.bounds[1], wave.bounds[2], wave.bounds[3] = sx, sy, sx + 1, sy + 1
    wave.bucket[1, 0] = sy * n + sx
    wave.filled[1] = 1


@jit
def _edge_offsets(cell, n, shift_x, shift_y, x0, y0, x1, y1, offsets):
    """Write storage offsets of the eight neighbours at the torus' seam; 0 outside the rectangle."""
    x, y = (cell % n - shift_x) % n, (cell // n - shift_y) % n
    k = 0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            if dx == 0 and dy == 0:
                continue
            nx, ny = x + dx, y + dy
            offsets[k] = 0
            if x0 <= nx < x1 and y0 <= ny < y1:
                offsets[k] = ((ny + shift_y) % n) * n + (nx + shift_x) % n - cell
            k += 1


@jit
def _escapes(layers, wave, cell):
    """Return True if a closed cell may be crossed because the robot started inside inflation.

    A robot inside a zone may cross all of it, to leave it.
    """
    n = layers.raw.shape[0]
    sy, sx = cell // n, cell % n
    start_x, start_y = wave.state[_START_X], wave.state[_START_Y]
    if layers.near[start_y, start_x] & ZONE and layers.near[sy, sx] == ZONE:
        return layers.raw[sy, sx] == FREE
    dx, dy = abs(sx - start_x), abs(sy - start_y)
    dx, dy = min(dx, n - dx), min(dy, n - dy)
    return dx * dx + dy * dy <= wave.state[_ESCAPE2] and layers.raw[sy, sx] == FREE


@jit
def grow_wave(layers, wave, body, origin_x, origin_y, x0, y0, x1, y1, budget):
    """Settle up to `budget` cells inside a world rectangle; return True if none are left.

    - `body`: see `on_trail`.
    - `origin_x`, `origin_y`: world cell of the window's corner.
    - `x0`, `y0`, `x1`, `y1`: the half-open rectangle.
    """
    n = layers.raw.shape[0]
    shift_x, shift_y = origin_x % n, origin_y % n
    distance, bucket, filled = wave.distance.ravel(), wave.bucket, wave.filled
    near, raw = layers.near.ravel(), layers.raw.ravel()
    escaping = wave.state[_ESCAPE2] >= 0
    # The rectangle in window coordinates.
    x0, x1, y0, y1 = x0 - origin_x, x1 - origin_x, y0 - origin_y, y1 - origin_y
    level, queued = wave.state[_LEVEL], wave.state[_QUEUED]
    bounds_x0, bounds_y0, bounds_x1, bounds_y1 = wave.bounds
    # Offsets of the eight neighbours in a flat layer, in row order; `edge` where storage wraps.
    inner = np.array([-n - 1, -n, -n + 1, -1, 1, n - 1, n, n + 1])
    edge = np.zeros(8, np.int64)
    cost = np.array([DIAGONAL, 5, DIAGONAL, 5, 5, DIAGONAL, 5, DIAGONAL], np.int32)  # 5: STRAIGHT
    done = 0
    while queued > 0 and done < budget:
        slot = level & (BUCKETS - 1)
        if filled[slot] == 0:
            level += 1
            continue
        filled[slot] -= 1
        queued -= 1
        cell = bucket[slot, filled[slot]]
        if distance[cell] != level:
            continue  # a shorter path was found after this entry was queued
        done += 1
        sy = cell // n
        sx = cell - sy * n
        bounds_x0, bounds_x1 = min(bounds_x0, sx), max(bounds_x1, sx + 1)
        bounds_y0, bounds_y1 = min(bounds_y0, sy), max(bounds_y1, sy + 1)
        y = sy - shift_y if sy >= shift_y else sy - shift_y + n
        x = sx - shift_x if sx >= shift_x else sx - shift_x + n
        offsets = inner
        if (
            not (x0 < x < x1 - 1 and y0 < y < y1 - 1)
            or not (0 < sx < n - 1 and 0 < sy < n - 1)
        ):  # fmt: skip
            if not (x0 <= x < x1 and y0 <= y < y1):
                continue  # the window has rolled: its storage is another place now
            _edge_offsets(cell, n, shift_x, shift_y, x0, y0, x1, y1, edge)
            offsets = edge
        for k in range(8):
            neighbour = cell + offsets[k]
            if cost[k] == DIAGONAL and (
                near[cell + offsets[_NEXT_TO_DIAGONAL[k, 0]]] != 0
                or near[cell + offsets[_NEXT_TO_DIAGONAL[k, 1]]] != 0
            ):
                continue  # no cut corners, as in the planner
            old_cost = distance[neighbour]
            new_cost = level + cost[k]
            if old_cost != 0:
                if old_cost <= new_cost:
                    continue
            elif (
                (near[neighbour] != 0 or raw[neighbour] == 0)
                and not (escaping and _escapes(layers, wave, neighbour))
                and not on_trail(layers, neighbour // n, neighbour % n, body)
            ):
                continue
            new_slot = new_cost & (BUCKETS - 1)
            if filled[new_slot] == bucket.shape[1]:
                continue
            distance[neighbour] = new_cost
            bucket[new_slot, filled[new_slot]] = neighbour
            filled[new_slot] += 1
            queued += 1
    wave.state[_LEVEL], wave.state[_QUEUED] = level, queued
    wave.bounds[0], wave.bounds[1] = bounds_x0, bounds_y0
    wave.bounds[2], wave.bounds[3] = bounds_x1, bounds_y1
    return queued == 0


@jit
def nearest_reached(layers, distance, x0, y0, x1, y1, px, py, radius):
    """Return the free reached cell whose centre is nearest to a point, all in cells.

    Returns:
        (world x, world y, distance entry); the last is 0 if there is none.
    """
    n = layers.raw.shape[0]
    x, y = int(np.floor(px)), int(np.floor(py))
    if x0 <= x < x1 and y0 <= y < y1:
        entry = distance[y % n, x % n]
        free = bit_get(layers.known, y % n, x % n) and not bit_get(layers.blocked, y % n, x % n)
        if entry != 0 and free:
            return x, y, entry
    best, best_x, best_y = radius * radius, 0, 0
    found = np.int32(0)
    for y in range(max(int(np.floor(py - radius)), y0), min(int(np.floor(py + radius)) + 1, y1)):
        sy = y % n
        for x in range(
            max(int(np.floor(px - radius)), x0), min(int(np.floor(px + radius)) + 1, x1)
        ):
            dx, dy = x + 0.5 - px, y + 0.5 - py
            d2 = dx * dx + dy * dy
            if d2 > best or (d2 == best and found != 0):
                continue
            sx = x % n
            entry = distance[sy, sx]
            if entry == 0 or bit_get(layers.blocked, sy, sx) or not bit_get(layers.known, sy, sx):
                continue
            best, best_x, best_y, found = d2, x, y, entry
    return best_x, best_y, found


@jit
def path_lengths(layers, distance, x0, y0, x1, y1, res, xy, kind, radius, n, out):
    """Do the work of `TravelCostField.path_lengths_m`."""
    for i in range(n):
        _, _, entry = nearest_reached(
            layers, distance, x0, y0, x1, y1, xy[i, 0] / res, xy[i, 1] / res, radius[kind[i]] / res
        )
        out[i] = (entry - 1) / STRAIGHT * res if entry != 0 else np.inf


@jit
def trace(distance, x0, y0, x1, y1, x, y, cells):
    """Trace the path back from a world cell to the start of a field.

    - `x0`, `y0`, `x1`, `y1`: world cells where the field is valid, see `TravelCostField.field`.
    - `cells`: (cap, 2) int64 output, world cells, the given one first.

    Returns:
        The number of cells; 0 if the cell was not reached.
    """
    n, k = distance.shape[0], 0
    if not (x0 <= x < x1 and y0 <= y < y1) or distance[y % n, x % n] == 0:
        return 0
    while k < len(cells):
        cells[k, 0], cells[k, 1] = x, y
        k += 1
        cost, came_x, came_y = distance[y % n, x % n], x, y
        for ny in range(max(y - 1, y0), min(y + 2, y1)):
            for nx in range(max(x - 1, x0), min(x + 2, x1)):
                other = distance[ny % n, nx % n]
                step = DIAGONAL if nx != x and ny != y else STRAIGHT
                if other > 0 and other + step == cost:
                    came_x, came_y = nx, ny
        if came_x == x and came_y == y:
            break
        x, y = came_x, came_y
    return k


@jit
def first_in_sight(layers, distance, x0, y0, x1, y1, res, surface, within, points, except_disc):
    """Do the work of `TravelCostField.stopping_point`; the result is as in `nearest_reached`."""
    n, k, radius = layers.raw.shape[0], len(surface), within / res
    at = np.empty((k, 2))  # in cells, relative to cell centres
    first_x, first_y, last_x, last_y = x1, y1, x0, y0
    not_x, not_y, not_radius = except_disc
    not_x, not_y, not_radius = not_x / res - 0.5, not_y / res - 0.5, not_radius / res
    for i in range(k):
        at[i, 0], at[i, 1] = surface[i, 0] / res - 0.5, surface[i, 1] / res - 0.5
        first_x = min(first_x, int(np.ceil(at[i, 0] - radius)))
        first_y = min(first_y, int(np.ceil(at[i, 1] - radius)))
        last_x = max(last_x, int(np.floor(at[i, 0] + radius)) + 1)
        last_y = max(last_y, int(np.floor(at[i, 1] + radius)) + 1)
    best_x, best_y, found = 0, 0, np.int32(0)
    for y in range(max(first_y, y0), min(last_y, y1)):
        sy = y % n
        for x in range(max(first_x, x0), min(last_x, x1)):
            sx = x % n
            entry = distance[sy, sx]
            if entry == 0 or (found != 0 and entry >= found):
                continue
            if bit_get(layers.blocked, sy, sx) or not bit_get(layers.known, sy, sx):
                continue
            if (x - not_x) ** 2 + (y - not_y) ** 2 < not_radius**2:
                continue
            if _sees(layers, x, y, at, radius, points):
                best_x, best_y, found = x, y, entry
    return best_x, best_y, found


@jit
def _sees(layers, x, y, at, radius, points):
    """Return True if enough `points` of (k, 2) are within the radius of a cell and in sight."""
    n_near, n_seen = 0, 0
    for i in range(len(at)):
        dx, dy = at[i, 0] - x, at[i, 1] - y
        n_near += dx * dx + dy * dy <= radius * radius
    for i in range(len(at)):
        if n_seen + n_near < points:
            return False
        dx, dy = at[i, 0] - x, at[i, 1] - y
        if dx * dx + dy * dy <= radius * radius:
            n_near -= 1
            n_seen += _in_sight(layers, x, y, dx, dy)
            if n_seen >= points:
                return True
    return False


@jit
def _in_sight(layers, x, y, dx, dy):
    """Return True if no wall stands between a cell's centre and a point.

    Cells near the point do not count, because they are the object itself.
    """
    n = layers.raw.shape[0]
    length = math.hypot(dx, dy)
    for k in range(int(length - _OWN_CELLS) + 1):
        f = k / max(length, 1.0)
        cx, cy = math.floor(x + 0.5 + f * dx), math.floor(y + 0.5 + f * dy)
        if layers.raw[cy % n, cx % n] >= OCCUPIED and layers.top[cy % n, cx % n] >= TALL:
            return False
    return True
