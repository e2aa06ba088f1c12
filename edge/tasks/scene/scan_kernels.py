"""Kernels over LiDAR points and cells of the ground, for `projection` and `terrain`."""

from __future__ import annotations

import numpy as np

from edge.jit import jit

NEAREST_M = 0.1
"""Points nearer to the camera than this are in no picture."""


@jit
def points_of_windows(cloud, T, camera, boxes, masks, margin, keep, mask_of, point_of, depth_of):
    """Find the points of a cloud that are in windows around boxes (OpenNav eq. 2).

    - `cloud`: (n, 3) float32, any frame; points that are not finite are in no window.
    - `T`: (4, 4) float64, from the cloud's frame to the optical frame.
    - `camera`: width, height in pixels, fx, fy, cx, cy.
    - `boxes`: (k, 4) float32 xyxy in pixels.
    - `masks`: (k, rows, columns) bool, over each box; (0, rows, columns): the boxes are the masks.
    - `margin`: share of a box's width and height by which its window is larger on each side.
    - `keep`: (n,) bool, points to use.
    - `mask_of`: (m,) int32 output; for a point in window i the value is i if it is on the mask,
      else -1 - i.
    - `point_of`: (m,) int32 output, index into `cloud`, ascending.
    - `depth_of`: (m,) float32 output.

    Returns:
        The number of points found. If it is more than m, only the first m were written.
    """
    width, height, fx, fy, cx, cy = camera
    k, room, found = len(boxes), len(mask_of), 0
    masked = len(masks) == k and k > 0
    x0, y0 = np.empty(k, np.float32), np.empty(k, np.float32)
    x1, y1 = np.empty(k, np.float32), np.empty(k, np.float32)
    for i in range(k):
        across, down = margin * (boxes[i, 2] - boxes[i, 0]), margin * (boxes[i, 3] - boxes[i, 1])
        x0[i], x1[i] = boxes[i, 0] - across, boxes[i, 2] + across
        y0[i], y1[i] = boxes[i, 1] - down, boxes[i, 3] + down
    rows, columns = masks.shape[1], masks.shape[2]
    for p in range(len(cloud)):
        px, py, pz = cloud[p, 0], cloud[p, 1], cloud[p, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not z > NEAREST_M or not keep[p]:  # also skips NaN
            continue
        # Projection has pixel centres at integers, boxes have pixel corners there: add 0.5.
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


@jit
def best_surface(depth, on, gap_m, gap_share):
    """Split points where their depth jumps, and return the part that fits the mask best.

    The background of an object continues outside its mask, and an obstacle in front of it rarely
    covers the mask. So the score of a part is its intersection over union with the mask, counted in
    points: its points on the mask, over all points on the mask and its own points off the mask.

    Args:
        depth: (n,) float32, ascending.
        on: (n,) bool, True if a point is on the mask.
        gap_m: a jump is longer than this plus `gap_share` of the depth.
        gap_share: see `gap_m`.

    Returns:
        Half-open range of the part; the nearest if several are equal. (0, 0): no point is on the
        mask.
    """
    n, on_mask = len(depth), 0
    for i in range(n):
        on_mask += on[i]
    begin, first, last, best = 0, 0, 0, 0.0
    in_part, off_mask = 0, 0  # points of the current part on the mask, and off it
    for i in range(n):
        if on[i]:
            in_part += 1
        else:
            off_mask += 1
        if i + 1 < n and depth[i + 1] - depth[i] <= gap_m + gap_share * depth[i]:
            continue
        fit = in_part / max(on_mask + off_mask, 1)
        if fit > best:
            first, last, best = begin, i + 1, fit
        begin, in_part, off_mask = i + 1, 0, 0
    return first, last


@jit
def grow_ground(low, row, column, z_m, step_m, slope, cell_m, reach, ground, known):
    """Estimate the height of the ground by cells, from the robot outwards.

    A cell is ground if the height of its lowest point differs from nearby ground by at most
    `step_m` plus `slope` times the distance. Nearby means within `reach` cells, to bridge the gaps
    between scan lines. Each other cell takes the height of the ground that is the fewest steps
    away.

    Args:
        low: (h, w) float32, lowest z of the points in each cell; inf for a cell without points.
        row: the robot's cell.
        column: the robot's cell.
        z_m: height of the ground under the robot.
        step_m: largest step.
        slope: largest slope.
        cell_m: side of a cell.
        reach: largest gap in cells.
        ground: (h, w) float32 output, height.
        known: (h, w) bool output, True if the ground was seen.
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
    # Ground does not rise faster than the slope within reach: small steps lead up on to a hedge.
    count, found = found, 0
    lowest_near = np.empty(count)
    for i in range(count):
        r, c, limit = queue[i] // w, queue[i] % w, np.inf
        for y in range(max(r - reach, 0), min(r + reach + 1, h)):
            for x in range(max(c - reach, 0), min(c + reach + 1, w)):
                if known[y, x]:
                    away_m = cell_m * np.sqrt((y - r) ** 2 + (x - c) ** 2)
                    limit = min(limit, ground[y, x] + step_m + slope * away_m)
        lowest_near[i] = limit
    for i in range(count):
        r, c = queue[i] // w, queue[i] % w
        known[r, c] = ground[r, c] <= lowest_near[i]
        if known[r, c]:
            queue[found] = queue[i]
            found += 1
    filled, done = known.copy(), 0  # last pass: spread the height to all other cells
    while done < found:
        r, c = queue[done] // w, queue[done] % w
        done += 1
        for y in range(max(r - 1, 0), min(r + 2, h)):
            for x in range(max(c - 1, 0), min(c + 2, w)):
                if not filled[y, x]:
                    filled[y, x], ground[y, x] = True, ground[r, c]
                    queue[found] = y * w + x
                    found += 1
