"""Kernels of the map update (VL-Nav algorithm 1).

They clear stale obstacles, mark new ones, and free the cells along rays. `RollingMap` calls them.
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit
from edge.mapping.layers import ARRIVED, BUMPED, FREE, OCCUPIED, UNSEEN, add_disc, bit_set, set_free
from edge.mapping.points import FLOOR, HEIGHT_CODES, LOWEST_OBSTACLE, is_open

MOST_FLOOR_UPDATES = 10
"""`Layers.top` of a bumped cell counts the updates in a row that saw only floor, up to this."""
SURELY_FREE = 3
"""`Layers.top` of a free cell counts the updates that saw its floor, up to this. An obstacle that
comes after so many arrived there; after fewer, it may be a wall that was missed from afar."""


@jit
def apply_scan(
    layers, shift_x, shift_y, corner_x, corner_y, scan, polar, lost, sensor_z,
    obstacle_min_m, obstacle_max_m, coded_m, clear_after, disc, changed, explored,
):  # fmt: skip
    """Write a classified scan into the map, and clear `scan.seen`.

    A ray frees unseen cells that it shows to be open (`is_open`). An occupied cell without a hit is
    stale if a ray passed over it below its top, because that ray would have hit the obstacle. If
    the obstacle arrived there, floor in the cell is enough. Obstacles below the camera's view stay.

    - `layers`: layers of the map; `shift_x`, `shift_y`: storage cell of the window's corner.
    - `scan`, `polar`: the classified scan, and its polar grid; see `edge.mapping.points`.
    - `lost`: (sectors,) uint64, see `lost_rays`.
    - `sensor_z`: height of the sensor.
    - `obstacle_min_m`, `obstacle_max_m`: heights over the ground between which a point is an
      obstacle.
    - `coded_m`: height of the highest code of `Layers.top`.
    - `disc`: half widths of the inflation disc.
    - `corner_x`, `corner_y`: window coordinates of cell (0, 0) of the scratch grid.
    - `clear_after`: updates in a row that must see through an obstacle to clear it.
    - `changed`: rectangle of cells whose published state changed.
    - `explored`: rectangle of all cells ever seen, window coordinates.
    """
    n = layers.raw.shape[0]
    clip = (0, 0, n, n)
    x0, y0, x1, y1 = scan.box
    raw, seen, flipped = layers.raw, scan.seen, scan.flipped
    sector_of, distance_m, reach_m = polar.sector_of, polar.distance_m, scan.reach_m
    n_flipped = 0
    for cy in range(y0, y1):
        sy = cy + corner_y + shift_y
        if sy >= n:
            sy -= n
        for cx in range(x0, x1):
            sx = cx + corner_x + shift_x
            if sx >= n:
                sx -= n
            code, state = seen[cy, cx], raw[sy, sx]
            seen[cy, cx] = 0
            if code >= LOWEST_OBSTACLE or state >= OCCUPIED:
                if _update_obstacle(
                    layers, sy, sx, state, code, scan, polar, cy, cx, sensor_z, obstacle_max_m,
                    coded_m, clear_after,
                ):  # fmt: skip
                    flipped[n_flipped] = (cy << 16) | cx
                    n_flipped += 1
            elif state == FREE:
                if code == FLOOR and layers.top[sy, sx] < SURELY_FREE:
                    layers.top[sy, sx] += 1
            elif state == UNSEEN:
                free = code != 0
                if not free and distance_m[cy, cx] < reach_m[sector_of[cy, cx]]:
                    free = _is_open(
                        scan, polar, lost, cy, cx, sensor_z, obstacle_min_m, obstacle_max_m
                    )
                if free:
                    set_free(layers, shift_x, shift_y, cx + corner_x, cy + corner_y, changed)
    for i in range(n_flipped):
        x, y = (flipped[i] & 0xFFFF) + corner_x, (flipped[i] >> 16) + corner_y
        occupied = raw[(y + shift_y) % n, (x + shift_x) % n] >= OCCUPIED
        add_disc(layers, shift_x, shift_y, x, y, 1 if occupied else -1, disc, clip, changed)
    explored[0] = min(explored[0], x0 + corner_x)
    explored[1] = min(explored[1], y0 + corner_y)
    explored[2] = max(explored[2], x1 + corner_x)
    explored[3] = max(explored[3], y1 + corner_y)


@jit(inline="always")
def _is_open(scan, polar, lost, cy, cx, sensor_z, obstacle_min_m, obstacle_max_m):
    """Return `is_open` of a cell, from the rays that end in the next ring or farther.

    Near the sensor a cell is wider than a sector, so its returns may be in each sector it subtends.
    """
    sector, ring, d = polar.sector_of[cy, cx], polar.ring_of[cy, cx], polar.distance_m[cy, cx]
    slope, spread = np.float32(np.inf), int(polar.spread[cy, cx])
    for k in range(sector - spread, sector + spread + 1):
        j = k % polar.sectors
        if scan.reach_m[j] > 0.0:
            slope = min(slope, scan.pass_slope[j, max(ring - 1, 0)])
    over_ground_m = sensor_z - scan.ground_m[sector, ring]
    below_ray_m = over_ground_m + slope * d
    return is_open(lost[sector], below_ray_m, over_ground_m, d, obstacle_min_m, obstacle_max_m)


@jit
def _update_obstacle(
    layers, sy, sx, state, code, scan, polar, cy, cx, sensor_z, obstacle_max_m, coded_m, clear_after
):
    """Update a cell that is or was occupied; return True if it became occupied or free.

    `state` is the cell's value in `Layers.raw`, `code` that in `PolarScan.seen`. A bumped cell
    stays occupied. Its top counts the updates in a row that saw only floor there.
    """
    if state == BUMPED:
        if code == FLOOR:
            layers.top[sy, sx] = min(layers.top[sy, sx] + 1, MOST_FLOOR_UPDATES)
        elif code != 0:
            layers.top[sy, sx] = 0
        return False
    sector, ring = polar.sector_of[cy, cx], polar.ring_of[cy, cx]
    slope = scan.pass_slope[sector, ring] if scan.reach_m[sector] > 0.0 else np.float32(np.inf)
    # Height over the ground at which the lowest ray flew over this cell.
    below_ray_m = sensor_z + slope * polar.distance_m[cy, cx] - scan.ground_m[sector, ring]
    m_per_code = coded_m / HEIGHT_CODES
    top = layers.top[sy, sx]
    arrived = state >= ARRIVED or (state == FREE and top >= SURELY_FREE)
    occupied = ARRIVED if arrived else OCCUPIED
    if code >= LOWEST_OBSTACLE:
        if state >= OCCUPIED and top > code:
            # Keep the greater height, unless a ray has just passed below it.
            highest_code = LOWEST_OBSTACLE + int(min(max(below_ray_m / m_per_code, 0.0), 252.0))
            code = max(code, min(top, highest_code))
        layers.top[sy, sx] = code
        layers.raw[sy, sx] = occupied
        bit_set(layers.known, sy, sx, True)
        return state < OCCUPIED
    # Codes are rounded down, and beams of a planar LiDAR are as high as their hits: add one code.
    passed_below = below_ray_m < min((top - LOWEST_OBSTACLE + 1) * m_per_code, obstacle_max_m)
    # Floor is enough where something arrived: if something is close behind, no ray passes over.
    if not (passed_below or (state >= ARRIVED and code == FLOOR)):
        return False
    if state - occupied + 1 < clear_after:
        layers.raw[sy, sx] = state + 1
        return False
    layers.raw[sy, sx] = FREE
    layers.top[sy, sx] = SURELY_FREE if arrived else 0
    return True


@jit
def free_footprint(layers, shift_x, shift_y, x, y, footprint, body, disc, changed, explored):
    """Free the cells under the robot: unknown cells of the footprint, and all cells of the body.

    A bumped cell stays closed until the robot stands on its centre (see `ContactObstacles`).
    `footprint` and `body` are discs around the robot's cell; the footprint is larger. `disc` is the
    inflation's.
    """
    n = layers.raw.shape[0]
    clip = (0, 0, n, n)
    radius, inner = len(footprint) // 2, len(body) // 2
    for k in range(len(footprint)):
        wy = y + k - radius
        if wy < 0 or wy >= n:
            continue
        row = k - radius + inner
        body_half = body[row] if 0 <= row < len(body) else -1
        for wx in range(max(x - footprint[k], 0), min(x + footprint[k] + 1, n)):
            sy, sx = (wy + shift_y) % n, (wx + shift_x) % n
            state = layers.raw[sy, sx]
            if state == UNSEEN:
                set_free(layers, shift_x, shift_y, wx, wy, changed)
            elif OCCUPIED <= state < BUMPED and abs(wx - x) <= body_half:
                layers.raw[sy, sx], layers.top[sy, sx] = FREE, 0
                add_disc(layers, shift_x, shift_y, wx, wy, -1, disc, clip, changed)
    explored[0] = min(explored[0], max(x - radius, 0))
    explored[1] = min(explored[1], max(y - radius, 0))
    explored[2] = max(explored[2], min(x + radius + 1, n))
    explored[3] = max(explored[3], min(y + radius + 1, n))
