"""From boxes in the image to points in space. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

BINS = 128
SIDE = 24
"""A box is sampled at no more than SIDE × SIDE places."""
INNER = 0.8
"""Share of the box's width and height that is looked at: its rim is mostly background."""
NEAREST_SHARE = 0.3
"""The nearest surface holding this share of the box is taken for the object."""
GAP_M = 0.3
"""Surfaces further apart than this along the view are different things."""
FLOOR_M = 0.06
"""Points lower than this over the ground count only when the box shows nothing else."""


@njit(nogil=True, cache=True)
def cloud_raster(cloud, T_camera_cloud, fx, fy, cx, cy, cell_px, raster, points):
    """Nearest cloud point of every image cell.

    Args:
        cloud: (n, 3) float32, any frame; points that are not finite are ignored.
        T_camera_cloud: (4, 4) float64, optical frame from the cloud's.
        cell_px: side of a cell in pixels.
        raster: (rows, columns) int32 out, index into `points`, -1 where nothing lies.
        points: (n, 3) float32 out, the cloud in the optical frame.
    """
    rows, columns = raster.shape
    for r in range(rows):
        for c in range(columns):
            raster[r, c] = -1
    T = T_camera_cloud
    for i in range(len(cloud)):
        px, py, pz = cloud[i, 0], cloud[i, 1], cloud[i, 2]
        if not np.isfinite(px + py + pz):
            continue
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if z < 0.05:
            continue
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        c = int(np.floor((fx * x / z + cx + 0.5) / cell_px))
        r = int(np.floor((fy * y / z + cy + 0.5) / cell_px))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            continue
        points[i, 0], points[i, 1], points[i, 2] = x, y, z
        held = raster[r, c]
        if held < 0 or z < points[held, 2]:
            raster[r, c] = i


@njit(nogil=True, cache=True)
def sample_depth(depth, fx, fy, cx, cy, x0, y0, x1, y1, max_range, samples):
    """Points of a box of a depth image, in the optical frame, at most SIDE × SIDE.

    Returns:
        How many rows of `samples` (SIDE*SIDE, 3) float32 were written.
    """
    h, w = depth.shape
    u0, v0, u1, v1 = max(0, int(x0)), max(0, int(y0)), min(w, int(x1) + 1), min(h, int(y1) + 1)
    step_u, step_v = max(1, -(-(u1 - u0) // SIDE)), max(1, -(-(v1 - v0) // SIDE))
    n = 0
    for v in range(v0 + step_v // 2, v1, step_v):
        for u in range(u0 + step_u // 2, u1, step_u):
            z = depth[v, u]
            if z > 0.0 and z <= max_range:  # false for NaN
                samples[n, 0] = (u - cx) / fx * z
                samples[n, 1] = (v - cy) / fy * z
                samples[n, 2] = z
                n += 1
    return n


@njit(nogil=True, cache=True)
def sample_raster(raster, points, cell_px, x0, y0, x1, y1, max_range, samples):
    """Like `sample_depth`, from a raster of `cloud_raster`."""
    h, w = raster.shape
    c0, r0 = max(0, int(x0 / cell_px)), max(0, int(y0 / cell_px))
    c1, r1 = min(w, int(x1 / cell_px) + 1), min(h, int(y1 / cell_px) + 1)
    step_c, step_r = max(1, -(-(c1 - c0) // SIDE)), max(1, -(-(r1 - r0) // SIDE))
    n = 0
    for r in range(r0 + step_r // 2, r1, step_r):
        for c in range(c0 + step_c // 2, c1, step_c):
            i = raster[r, c]
            if i >= 0 and points[i, 2] <= max_range:
                samples[n, 0], samples[n, 1], samples[n, 2] = (
                    points[i, 0],
                    points[i, 1],
                    points[i, 2],
                )
                n += 1
    return n


@njit(nogil=True, cache=True)
def drop_floor(samples, n, T, floor_z):
    """Move samples above `floor_z` (map) to the front; all stay when too few are above.

    Returns:
        How many count.
    """
    above = 0
    for i in range(n):
        z = T[2, 0] * samples[i, 0] + T[2, 1] * samples[i, 1] + T[2, 2] * samples[i, 2] + T[2, 3]
        if z > floor_z:
            above += 1
    if above < 8 or above < 0.1 * n:
        return n
    k = 0
    for i in range(n):
        x, y, d = samples[i, 0], samples[i, 1], samples[i, 2]
        if T[2, 0] * x + T[2, 1] * y + T[2, 2] * d + T[2, 3] > floor_z:
            samples[k, 0], samples[k, 1], samples[k, 2] = x, y, d
            k += 1
    return k


@njit(nogil=True, cache=True)
def surface(samples, n, max_range, histogram):
    """Depth interval of the object among a box's samples.

    A histogram of depth falls into surfaces wherever it is (nearly) empty for GAP_M. The
    nearest surface with NEAREST_SHARE of the samples is the object; else the largest.

    Args:
        histogram: (BINS,) int32, scratch.

    Returns:
        (low, high) in metres, low > high when there are no samples.
    """
    if n == 0:
        return 1.0, 0.0
    width = max_range / BINS
    gap = max(2, int(np.ceil(GAP_M / width)))
    sparse = n // 200
    histogram[:] = 0
    for i in range(n):
        histogram[min(BINS - 1, int(samples[i, 2] / width))] += 1
    best, best_low, best_high = 0, 0, -1
    count, low, high = 0, -1, -1
    for b in range(BINS + gap):
        filled = b < BINS and histogram[b] > sparse
        if filled:
            if low < 0:
                low = b
            high = b
            count += histogram[b]
        if (low >= 0 and b - high >= gap) or b == BINS + gap - 1:
            if count > best:
                best, best_low, best_high = count, low, high
                if count >= NEAREST_SHARE * n:
                    break
            count, low = 0, -1
    if best == 0:  # every bin is sparse: all of it is one surface
        return 0.0, max_range
    return best_low * width, (best_high + 1) * width


@njit(nogil=True, cache=True)
def place(samples, n, low, high, T, points, scratch):
    """Median point and a spread-out subset of the samples with depth in [low, high], in `map`.

    Args:
        T: (4, 4) float64, map from optical frame.
        points: (k, 3) float32 out.
        scratch: (3, SIDE*SIDE) float32.

    Returns:
        (x, y, z, how many samples, how many rows of `points`).
    """
    m = 0
    for i in range(n):
        x, y, z = samples[i, 0], samples[i, 1], samples[i, 2]
        if z < low or z > high:
            continue
        scratch[0, m] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        scratch[1, m] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        scratch[2, m] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        m += 1
    if m == 0:
        return 0.0, 0.0, 0.0, 0, 0
    k = min(m, len(points))
    for j in range(k):
        i = j * m // k
        points[j, 0], points[j, 1], points[j, 2] = scratch[0, i], scratch[1, i], scratch[2, i]
    return (
        np.median(scratch[0, :m]), np.median(scratch[1, :m]), np.median(scratch[2, :m]), m, k,
    )  # fmt: skip


@njit(nogil=True, cache=True)
def lift_boxes(
    use_cloud, depth, raster, raster_points, cell_px, fx, fy, cx, cy, boxes, T_map_camera,
    floor_z, max_range, min_points, samples, histogram, scratch,
    center, points, n_points, n_samples, valid,
):  # fmt: skip
    """Lift every box; see `lift.Lifter`.

    Args:
        use_cloud: sample `raster` and `raster_points`, else `depth`.
        boxes: (n, 4) float32.
        center: (n, 3), points: (n, k, 3) float32 out, in `map`.
        n_points, n_samples: (n,) int32 out; valid: (n,) bool out.
    """
    shrink = 0.5 * (1.0 - INNER)
    for i in range(len(boxes)):
        x0, y0, x1, y1 = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        valid[i] = False
        n_points[i] = n_samples[i] = 0
        if not np.isfinite(x0 + y0 + x1 + y1):
            continue
        dx, dy = shrink * (x1 - x0), shrink * (y1 - y0)
        x0, y0, x1, y1 = x0 + dx, y0 + dy, x1 - dx, y1 - dy
        if use_cloud:
            n = sample_raster(raster, raster_points, cell_px, x0, y0, x1, y1, max_range, samples)
        else:
            n = sample_depth(depth, fx, fy, cx, cy, x0, y0, x1, y1, max_range, samples)
        n = drop_floor(samples, n, T_map_camera, floor_z)
        low, high = surface(samples, n, max_range, histogram)
        x, y, z, m, k = place(samples, n, low, high, T_map_camera, points[i], scratch)
        center[i, 0], center[i, 1], center[i, 2] = x, y, z
        n_samples[i], n_points[i] = m, k
        valid[i] = m >= min_points
