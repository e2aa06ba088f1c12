"""Loops over LiDAR points and over cells of the ground. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

NEAREST_M = 0.1
"""What is nearer to the camera than this is in no picture."""


@njit(nogil=True, cache=True)
def points_of_windows(cloud, T, camera, boxes, masks, beside, keep, mask_of, point_of, depth_of):
    """Which points of a cloud lie in the windows around some boxes (OpenNav eq. 2).

    Args:
        cloud: (n, 3) float32, any frame; points that are not finite lie in no window.
        T: (4, 4) float64, optical frame from the cloud's.
        camera: width, height in pixels, fx, fy, cx, cy.
        boxes: (k, 4) float32 xyxy in pixels.
        masks: (k, rows, columns) bool, over each box; (0, rows, columns): the boxes are the masks.
        beside: share of a box's width and height that its window is wider on each side.
        keep: (n,) bool, points that count.
        mask_of: (m,) int32 out, the window's box i for a point on its mask, -1 - i beside it.
        point_of: (m,) int32 out, index into `cloud`, ascending; depth_of: (m,) float32 out.

    Returns:
        How many there are; more than `m`: only `m` were written.
    """
    width, height, fx, fy, cx, cy = camera
    k, room, found = len(boxes), len(mask_of), 0
    masked = len(masks) == k and k > 0
    x0, y0 = np.empty(k, np.float32), np.empty(k, np.float32)
    x1, y1 = np.empty(k, np.float32), np.empty(k, np.float32)
    for i in range(k):
        across, down = beside * (boxes[i, 2] - boxes[i, 0]), beside * (boxes[i, 3] - boxes[i, 1])
        x0[i], x1[i] = boxes[i, 0] - across, boxes[i, 2] + across
        y0[i], y1[i] = boxes[i, 1] - down, boxes[i, 3] + down
    rows, columns = masks.shape[1], masks.shape[2]
    for p in range(len(cloud)):
        px, py, pz = cloud[p, 0], cloud[p, 1], cloud[p, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not z > NEAREST_M or not keep[p]:  # NaN is not either
            continue
        # Pixel centres are whole numbers, boxes count from corners.
        u = fx * (T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]) / z + cx + 0.5
        v = fy * (T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]) / z + cy + 0.5
        if not (0.0 <= u < width and 0.0 <= v < height):
            continue
        for i in range(k):
            if not (x0[i] <= u < x1[i] and y0[i] <= v < y1[i]):
                continue
            wide, high = boxes[i, 2] - boxes[i, 0], boxes[i, 3] - boxes[i, 1]
            on = 0.0 <= u - boxes[i, 0] < wide and 0.0 <= v - boxes[i, 1] < high
            if on and masked:
                on = masks[
                    i,
                    min(int((v - boxes[i, 1]) / high * rows), rows - 1),
                    min(int((u - boxes[i, 0]) / wide * columns), columns - 1),
                ]
            if found < room:
                mask_of[found] = i if on else -1 - i
                point_of[found], depth_of[found] = p, z
            found += 1
    return found


@njit(nogil=True, cache=True)
def best_surface(depth, on, gap_m, gap_share):
    """Of some points parted where their depth leaps, the part whose picture fits the mask best.

    What lies behind a thing goes on beside it, and what stands before it seldom covers its mask:
    the best part has the most points on the mask, of all on the mask and its own beside it
    (intersection over union, counted in returns).

    Args:
        depth: (n,) float32, ascending; on: (n,) bool, whether a point lies on the mask.
        gap_m, gap_share: a leap is longer than `gap_m` and `gap_share` of the depth together.

    Returns:
        Half-open range of the part; of equals the nearest. (0, 0): nothing is on the mask.
    """
    n, on_mask = len(depth), 0
    for i in range(n):
        on_mask += on[i]
    begin, first, last, best = 0, 0, 0, 0.0
    mine, beside = 0, 0
    for i in range(n):
        if on[i]:
            mine += 1
        else:
            beside += 1
        if i + 1 < n and depth[i + 1] - depth[i] <= gap_m + gap_share * depth[i]:
            continue
        fit = mine / max(on_mask + beside, 1)
        if fit > best:
            first, last, best = begin, i + 1, fit
        begin, mine, beside = i + 1, 0, 0
    return first, last


@njit(nogil=True, cache=True)
def lowest(points, x0_m, y0_m, cell_m, out):
    """The lowest point of each cell.

    Args:
        points: (n, 3) float32; those outside, or not finite, count nothing.
        x0_m, y0_m: the corner of cell (0, 0).
        out: (h, w) float32 out; inf where there is none.
    """
    h, w = out.shape
    out[:] = np.inf
    for i in range(len(points)):
        c, r = (points[i, 0] - x0_m) / cell_m, (points[i, 1] - y0_m) / cell_m
        if 0.0 <= c < w and 0.0 <= r < h and points[i, 2] < out[int(r), int(c)]:
            out[int(r), int(c)] = points[i, 2]


@njit(nogil=True, cache=True)
def grow_ground(low, row, column, z_m, step_m, slope, cell_m, reach, ground, known):
    """The ground's height, from where the robot stands outwards, by cells.

    A cell is ground where its lowest point is as high as the ground beside it, give or take
    `step_m` and `slope` times the way there; between scan lines it is looked for `reach` cells
    away. All other cells take the height of the ground that is the fewest steps away.

    Args:
        low: (h, w) float32, see `lowest`.
        row, column, z_m: the robot's cell, and the height of the ground that it stands on.
        ground: (h, w) float32 out; known: (h, w) bool out, where it was seen.
    """
    h, w = low.shape
    known[:] = False
    queue = np.empty(h * w, np.int64)
    done, found = 0, 1
    queue[0] = row * w + column
    ground[row, column], known[row, column] = z_m, True
    while done < found:
        r, c = queue[done] // w, queue[done] % w
        done += 1
        for y in range(max(r - reach, 0), min(r + reach + 1, h)):
            for x in range(max(c - reach, 0), min(c + reach + 1, w)):
                if known[y, x] or not low[y, x] < np.inf:
                    continue
                away_m = cell_m * np.sqrt((y - r) ** 2 + (x - c) ** 2)
                if abs(low[y, x] - ground[r, c]) <= step_m + slope * away_m:
                    ground[y, x], known[y, x] = low[y, x], True
                    queue[found] = y * w + x
                    found += 1
    filled, done = known.copy(), 0
    while done < found:
        r, c = queue[done] // w, queue[done] % w
        done += 1
        for y in range(max(r - 1, 0), min(r + 2, h)):
            for x in range(max(c - 1, 0), min(c + 2, w)):
                if not filled[y, x]:
                    filled[y, x], ground[y, x] = True, ground[r, c]
                    queue[found] = y * w + x
                    found += 1


@njit(nogil=True, cache=True)
def nearest_of_regions(regions, allowed, cells, best, at):
    """The allowed cell of each region that is nearest to a thing.

    Args:
        regions: (h, w) uint8, 0 = none; allowed: (h, w) bool.
        cells: (k, 2) float64, the thing's points as (column, row), in cells.
        best: (256,) float64 out, squared distance in cells; inf where a region has no such cell.
        at: (256, 2) int64 out, its (row, column).
    """
    best[:] = np.inf
    h, w = regions.shape
    for r in range(h):
        for c in range(w):
            region = regions[r, c]
            if region == 0 or not allowed[r, c]:
                continue
            for i in range(len(cells)):
                d = (cells[i, 0] - c - 0.5) ** 2 + (cells[i, 1] - r - 0.5) ** 2
                if d < best[region]:
                    best[region], at[region, 0], at[region, 1] = d, r, c
