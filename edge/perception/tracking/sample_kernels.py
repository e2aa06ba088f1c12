"""Kernels that sample the points of a box from a depth image, or from the raster of a cloud.

Arguments of many kernels:

- `view`: (depth, raster, points, cell_px, fx, fy, cx, cy). Depth: (h, w) float32. The next three
  are those of `cloud_raster`; cell_px is 0 if the depth image is sampled. The rest in pixels.
- `samples`: (SIDE*SIDE, 3) float32 out, points in the optical frame in metres.

`-(-a // b)` is a / b rounded up.
"""

from __future__ import annotations

import numpy as np

from edge.jit import jit

SIDE = 24
"""A box is sampled at no more than SIDE × SIDE pixels."""
STRIP_WIDTH = 0.12
"""Width of the strips next to a box, as a share of the box's size.

The strips show which surfaces continue beyond the box."""
STRIP_DISTANCE = 0.05
"""Distance of the strips from the box, as a share of its size, since no box is exact."""


@jit
def cloud_raster(cloud, T_camera_cloud, fx, fy, cx, cy, cell_px, raster, points):
    """Find the nearest cloud point of every image cell.

    Args:
        cloud: (n, 3) float32, any frame; points that are not finite are ignored.
        T_camera_cloud: (4, 4) float64, maps the cloud's frame into the optical frame.
        fx: horizontal focal length in pixels.
        fy: vertical focal length in pixels.
        cx: column of the principal point in pixels.
        cy: row of the principal point in pixels.
        cell_px: side of a cell in pixels.
        raster: (rows, columns) int32 out, index into `points`, -1 if the cell is empty.
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
        if z < 0.05:  # behind the camera or at its lens
            continue
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        c = int(np.floor((fx * x / z + cx + 0.5) / cell_px))
        r = int(np.floor((fy * y / z + cy + 0.5) / cell_px))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            continue
        points[i, 0], points[i, 1], points[i, 2] = x, y, z
        nearest = raster[r, c]
        if nearest < 0 or z < points[nearest, 2]:
            raster[r, c] = i


@jit
def sample_depth(depth, fx, fy, cx, cy, x0, y0, x1, y1, max_range, samples):
    """Sample the points of a box of a depth image, in the optical frame, at most SIDE × SIDE.

    Args:
        depth: (h, w) float32 in metres; NaN or 0 = no return.
        fx: see `cloud_raster`.
        fy: see `cloud_raster`.
        cx: see `cloud_raster`.
        cy: see `cloud_raster`.
        x0: left side of the box in pixels.
        y0: upper side of the box.
        x1: right side of the box.
        y1: lower side of the box.
        max_range: largest depth in metres.
        samples: (SIDE*SIDE, 3) float32 out.

    Returns:
        Number of rows of `samples` (SIDE*SIDE, 3) float32 that were written.
    """
    # Divide the box into at most SIDE x SIDE blocks, and take the middle pixel of each.
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


@jit
def sample_raster(raster, points, cell_px, x0, y0, x1, y1, max_range, samples):
    """Sample like `sample_depth`, from a raster of `cloud_raster`."""
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


@jit
def sample(view, x0, y0, x1, y1, max_range, samples):
    """Sample a box of a view by `sample_raster` or `sample_depth`."""
    depth, raster, points, cell_px, fx, fy, cx, cy = view
    if cell_px > 0:
        return sample_raster(raster, points, cell_px, x0, y0, x1, y1, max_range, samples)
    return sample_depth(depth, fx, fy, cx, cy, x0, y0, x1, y1, max_range, samples)


@jit
def sample_strips(view, box, max_range, strips, n):
    """Sample a strip next to each side of a box.

    Args:
        view: see the module.
        box: (4,) float32, the whole box.
        max_range: largest depth in metres.
        strips: (4, SIDE*SIDE, 3) float32 out.
        n: (4,) int32 out, rows written of each.
    """
    x0, y0, x1, y1 = box[0], box[1], box[2], box[3]
    near_u, near_v = STRIP_DISTANCE * (x1 - x0), STRIP_DISTANCE * (y1 - y0)
    far_u = near_u + max(3.0, STRIP_WIDTH * (x1 - x0))
    far_v = near_v + max(3.0, STRIP_WIDTH * (y1 - y0))
    sides = np.array(
        [
            [x0 - far_u, y0, x0 - near_u, y1],
            [x1 + near_u, y0, x1 + far_u, y1],
            [x0, y0 - far_v, x1, y0 - near_v],
            [x0, y1 + near_v, x1, y1 + far_v],
        ]
    )
    for side in range(4):
        u0, v0, u1, v1 = sides[side]
        n[side] = sample(view, u0, v0, u1, v1, max_range, strips[side])
