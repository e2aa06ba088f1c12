"""Ray casting of boxes, cylinders and ellipsoids, for the camera and LiDAR of `BoxWorld` (numba).

A primitive is one such solid, turned about the vertical axis. All functions take n primitives as
two arrays: `shape` (n,) uint8 is BOX, CYLINDER (axis z, elliptic) or ELLIPSOID; `geometry` (n, 8)
float64 has the columns X to SIN (below). The primitive's own frame has its origin at the centre.

`prim` (h, w) int32 has the index of the primitive that each pixel shows, -1 for none. Depth comes
first, then shading (`edge.lab.sim.shading`), so every pixel is shaded once. Primitives are drawn
front to back, each only inside the rectangle that it projects to. Tiles that a nearer primitive
already covers are skipped.
"""

from __future__ import annotations

import math

import numpy as np

from edge.jit import jit

BOX, CYLINDER, ELLIPSOID = 0, 1, 2
# Columns of `geometry`: centre [m], half of the extents [m], cosine and sine of the yaw.
X, Y, Z, HALF_X, HALF_Y, HALF_Z, COS, SIN = range(8)

NEAR_M = 0.02  # nearer surfaces are not seen
TILE_PX = 16  # side of a tile of the image
# A direction without a part along an axis would divide 0 by 0 in `_slab`.
_TINY = 1e-12


@jit(error_model="numpy")
def _slab(o, d, h):
    """Return the t at which the ray o + t d enters and leaves |x| <= h, along one axis.

    A box is the intersection of three such slabs.
    """
    inverse = 1.0 / (d if abs(d) > _TINY else _TINY)
    t_a, t_b = (-h - o) * inverse, (h - o) * inverse
    return (t_a, t_b) if t_a < t_b else (t_b, t_a)


@jit(error_model="numpy")
def _quadratic(a, b, c):
    """Return the least and largest t with a t^2 + 2 b t + c <= 0; (inf, -inf) if there is none."""
    if a < _TINY:
        return (-math.inf, math.inf) if c <= 0.0 else (math.inf, -math.inf)
    disc = b * b - a * c
    if disc < 0.0:
        return math.inf, -math.inf
    root = math.sqrt(disc)
    return (-b - root) / a, (-b + root) / a


@jit(error_model="numpy")
def _hit(shape, ox, oy, oz, dx, dy, dz, hx, hy, hz):
    """Return the distance t at which the ray o + t d enters a solid with half extents h.

    All are in the solid's own frame. The distance is inf if the ray misses the solid or starts
    inside it.
    """
    if shape == ELLIPSOID:
        px, py, pz, qx, qy, qz = ox / hx, oy / hy, oz / hz, dx / hx, dy / hy, dz / hz
        t_in, t_out = _quadratic(
            qx * qx + qy * qy + qz * qz,
            px * qx + py * qy + pz * qz,
            px * px + py * py + pz * pz - 1.0,
        )
    else:
        t_in, t_out = _slab(oz, dz, hz)
        if shape == BOX:
            x_in, x_out = _slab(ox, dx, hx)
            y_in, y_out = _slab(oy, dy, hy)
            t_in, t_out = max(t_in, x_in, y_in), min(t_out, x_out, y_out)
        else:
            px, py, qx, qy = ox / hx, oy / hy, dx / hx, dy / hy
            r_in, r_out = _quadratic(qx * qx + qy * qy, px * qx + py * qy, px * px + py * py - 1.0)
            t_in, t_out = max(t_in, r_in), min(t_out, r_out)
    return t_in if NEAR_M < t_in <= t_out else math.inf


@jit(error_model="numpy")
def into_local(geometry, T, local):
    """Fill `local` (3, 4) with the transform from a sensor's frame to a primitive's.

    `geometry` (8,) is the primitive's row, `T` (4, 4) the pose of the sensor in the world.
    """
    c, s = geometry[COS], geometry[SIN]
    for j in range(3):
        local[0, j] = c * T[0, j] + s * T[1, j]
        local[1, j] = -s * T[0, j] + c * T[1, j]
        local[2, j] = T[2, j]
    x, y = T[0, 3] - geometry[X], T[1, 3] - geometry[Y]
    local[0, 3], local[1, 3], local[2, 3] = c * x + s * y, -s * x + c * y, T[2, 3] - geometry[Z]


@jit(error_model="numpy")
def _corners(geometry, local, corners):
    """Fill `corners` (8, 3) with the corners of a primitive's box in the sensor's frame.

    `geometry` and `local` are as for `into_local`.
    Bits 0, 1 and 2 of a corner's index say if it is on the positive side in x, y and z.
    """
    for k in range(8):
        x = (geometry[HALF_X] if k & 1 else -geometry[HALF_X]) - local[0, 3]
        y = (geometry[HALF_Y] if k & 2 else -geometry[HALF_Y]) - local[1, 3]
        z = (geometry[HALF_Z] if k & 4 else -geometry[HALF_Z]) - local[2, 3]
        for j in range(3):
            corners[k, j] = local[0, j] * x + local[1, j] * y + local[2, j] * z


@jit(error_model="numpy")
def _rectangle(corners, fx, fy, cx, cy, width, height, rect):
    """Fill `rect` (u0, v0, u1, v1, inclusive) with the projection of a box cut at the near plane.

    Returns:
        The nearest z-depth of the box, or inf if no part of it is in view.
    """
    u0, v0, u1, v1 = math.inf, math.inf, -math.inf, -math.inf
    z_min = math.inf
    for k in range(8):
        z_min = min(z_min, corners[k, 2])
        for axis in range(4):
            # axis 3: the corner itself; 0-2: where the edge along that axis meets the near plane.
            x, y, z = corners[k, 0], corners[k, 1], corners[k, 2]
            if axis < 3:
                other = k ^ (1 << axis)  # the corner at the other end of this edge
                z_other = corners[other, 2]
                if not (z >= NEAR_M > z_other):
                    continue
                f = (z - NEAR_M) / (z - z_other)
                x += f * (corners[other, 0] - x)
                y += f * (corners[other, 1] - y)
                z = NEAR_M
            elif z < NEAR_M:
                continue
            u, v = fx * x / z + cx, fy * y / z + cy
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if u1 < 0.0 or v1 < 0.0 or u0 > width - 1 or v0 > height - 1 or u0 > u1:
        return math.inf
    rect[0], rect[1] = int(max(0.0, u0)), int(max(0.0, v0))
    rect[2], rect[3] = int(min(width - 1.0, u1 + 1.0)), int(min(height - 1.0, v1 + 1.0))
    return max(z_min, NEAR_M)


@jit(error_model="numpy")
def _box_row(index, hx, hy, hz, local, u0, fx, bx, by, bz, depth, prim):
    """Ray-test a row of pixels against a box, without branches, so that the compiler vectorises it.

    `u0` is the first pixel's column minus `cx`. A ray's direction in the box's frame is
    `local[:, 0] x + (bx, by, bz)`, with x = (u - cx) / fx. `depth` and `prim` are changed in place.

    Returns:
        The number of pixels for which the box is nearest.
    """
    count = 0
    ox, oy, oz = local[0, 3], local[1, 3], local[2, 3]
    ax, ay, az = local[0, 0], local[1, 0], local[2, 0]
    for k in range(len(depth)):
        x = (u0 + k) / fx
        dx, dy, dz = ax * x + bx, ay * x + by, az * x + bz
        ix = 1.0 / (dx if abs(dx) > _TINY else _TINY)
        iy = 1.0 / (dy if abs(dy) > _TINY else _TINY)
        iz = 1.0 / (dz if abs(dz) > _TINY else _TINY)
        xa, xb, ya, yb = (-hx - ox) * ix, (hx - ox) * ix, (-hy - oy) * iy, (hy - oy) * iy
        za, zb = (-hz - oz) * iz, (hz - oz) * iz
        t_in = max(max(min(xa, xb), min(ya, yb)), min(za, zb))
        t_out = min(min(max(xa, xb), max(ya, yb)), max(za, zb))
        nearer = (t_in > NEAR_M) & (t_in <= t_out) & (t_in < depth[k])
        depth[k] = t_in if nearer else depth[k]
        prim[k] = index if nearer else prim[k]
        count += nearer
    return count


@jit(error_model="numpy")
def _draw(index, shape, geometry, local, rect, z_min, fx, fy, cx, cy, depth, prim, tile_z):
    """Draw one primitive into `depth` and `prim`: ray-test the pixels of its rectangle `rect`.

    `index` is the primitive's index, `geometry` its row, `local` its `into_local`. `tile_z`
    is the largest depth in each tile. A tile is skipped if the primitive, nearest at `z_min`, is
    behind all of it.
    """
    height, width = depth.shape
    ox, oy, oz = local[0, 3], local[1, 3], local[2, 3]
    hx, hy, hz = geometry[HALF_X], geometry[HALF_Y], geometry[HALF_Z]
    for tile_y in range(rect[1] // TILE_PX, rect[3] // TILE_PX + 1):
        for tile_x in range(rect[0] // TILE_PX, rect[2] // TILE_PX + 1):
            if tile_z[tile_y, tile_x] <= z_min:
                continue
            top, left = tile_y * TILE_PX, tile_x * TILE_PX
            drawn = False
            for v in range(max(rect[1], top), min(rect[3] + 1, top + TILE_PX)):
                y = (v - cy) / fy
                bx = local[0, 1] * y + local[0, 2]
                by = local[1, 1] * y + local[1, 2]
                bz = local[2, 1] * y + local[2, 2]
                if shape == BOX:
                    first, end = max(rect[0], left), min(rect[2] + 1, left + TILE_PX)
                    row, prims = depth[v, first:end], prim[v, first:end]
                    if _box_row(index, hx, hy, hz, local, first - cx, fx, bx, by, bz, row, prims):
                        drawn = True
                    continue
                for u in range(max(rect[0], left), min(rect[2] + 1, left + TILE_PX)):
                    x = (u - cx) / fx
                    dx, dy, dz = local[0, 0] * x + bx, local[1, 0] * x + by, local[2, 0] * x + bz
                    t = _hit(shape, ox, oy, oz, dx, dy, dz, hx, hy, hz)
                    if t < depth[v, u]:
                        depth[v, u] = t
                        prim[v, u] = index
                        drawn = True
            if drawn:  # compute the largest depth in this tile again
                far = 0.0
                for v in range(top, min(height, top + TILE_PX)):
                    for u in range(left, min(width, left + TILE_PX)):
                        far = max(far, depth[v, u])
                tile_z[tile_y, tile_x] = far


@jit(error_model="numpy")
def render_depth(shape, geometry, T_map_camera, fx, fy, cx, cy, depth, prim):
    """Fill `depth` (h, w) float32 [m along z, inf = nothing] and `prim` (h, w) int32 (-1 = none).

    A ray has camera-frame direction (x, y, 1), so its parameter is the z-depth itself.
    """
    height, width = depth.shape
    n = len(shape)
    local, rects = np.empty((n, 3, 4)), np.empty((n, 4), np.int64)
    corners, nearest = np.empty((8, 3)), np.empty(n)
    for i in range(n):
        into_local(geometry[i], T_map_camera, local[i])
        _corners(geometry[i], local[i], corners)
        nearest[i] = _rectangle(corners, fx, fy, cx, cy, width, height, rects[i])
    rows, cols = (height + TILE_PX - 1) // TILE_PX, (width + TILE_PX - 1) // TILE_PX
    tile_z = np.full((rows, cols), np.inf)
    depth[:] = np.inf
    prim[:] = -1
    for i in np.argsort(nearest):
        if nearest[i] == math.inf:
            break
        _draw(
            i, shape[i], geometry[i], local[i], rects[i], nearest[i],
            fx, fy, cx, cy, depth, prim, tile_z,
        )  # fmt: skip


@jit(error_model="numpy")
def write_object_ids(hit, owner, near_m, far_m, depth, ids):
    """Fill `ids` with the object that each pixel shows; set depths out of the range to NaN.

    Args:
        hit: (...) int32 index into `owner` of the primitive or face that a pixel shows, -1 = none.
        owner: (n,) uint16 ids of the objects that these belong to, 0 = structure.
        near_m: least depth of the camera.
        far_m: largest depth of the camera.
        depth: (...) float32, changed in place.
        ids: (...) uint16, 0 for nothing.
    """
    hits, depths, flat_ids = hit.reshape(-1), depth.reshape(-1), ids.reshape(-1)
    for k in range(len(hits)):
        flat_ids[k] = 0 if hits[k] < 0 else owner[hits[k]]
        if depths[k] < near_m or depths[k] > far_m:
            depths[k] = np.nan


@jit(error_model="numpy")
def _fan_window(corners, n_azimuth, el_min, el_step, n_rings, window):
    """Fill `window` with the rays of a rotating LiDAR that can meet a box.

    `window` is (first ring, end of rings, first column, number of columns). It may be too large,
    never too small. Columns count from azimuth -pi; a box around the sensor's axis takes all
    columns. `corners` are in the LiDAR's frame.
    """
    r_max, z_lo, z_hi = 0.0, math.inf, -math.inf
    mid_x, mid_y = 0.0, 0.0  # middle of the box
    for k in range(8):
        r_max = max(r_max, math.hypot(corners[k, 0], corners[k, 1]))
        z_lo, z_hi = min(z_lo, corners[k, 2]), max(z_hi, corners[k, 2])
        mid_x += corners[k, 0] / 8.0
        mid_y += corners[k, 1] / 8.0
    middle = math.atan2(mid_y, mid_x)
    # `low`, `high`: azimuths of the outermost corners, from the middle's azimuth. `spread`: largest
    # planar distance of a corner from the middle. `r_min`: least planar distance of the box.
    low, high, spread, r_min = 0.0, 0.0, 0.0, math.inf
    for k in range(8):
        off = math.atan2(corners[k, 1], corners[k, 0]) - middle
        off -= 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5)  # to -pi..pi
        low, high = min(low, off), max(high, off)
        # In the plane, no point of the box is nearer than the nearest corner is along the line of
        # sight to the middle.
        r_min = min(r_min, corners[k, 0] * math.cos(middle) + corners[k, 1] * math.sin(middle))
        spread = max(spread, math.hypot(corners[k, 0] - mid_x, corners[k, 1] - mid_y))
    window[2], window[3] = 0, n_azimuth
    r_min = max(r_min, math.hypot(mid_x, mid_y) - spread, 0.0)
    if high - low < math.pi and r_min > 0.0:
        step = 2.0 * math.pi / n_azimuth
        first = math.floor((middle + low + math.pi) / step)
        window[2] = (first + n_azimuth) % n_azimuth
        window[3] = min(n_azimuth, int((high - low) / step) + 3)
    # Above the sensor, an edge looks highest where it is nearest; below, where it is farthest.
    top = math.atan2(z_hi, r_min if z_hi > 0.0 else r_max)
    bottom = math.atan2(z_lo, r_min if z_lo < 0.0 else r_max)
    window[0] = max(0, math.floor((bottom - el_min) / el_step))
    window[1] = min(n_rings, math.floor((top - el_min) / el_step) + 2)


@jit(error_model="numpy")
def cast_fan(shape, geometry, T_map_lidar, directions, el_min, el_step, ranges):
    """Fill `ranges` (rings, columns) float32 [m, inf = nothing] for a rotating LiDAR.

    `directions` (rings, columns, 3) float64 are unit vectors in the LiDAR's frame: ring r at
    elevation el_min + r el_step, column c at azimuth -pi + c 2 pi / columns.
    """
    n_rings, n_columns = ranges.shape
    local, corners, window = np.empty((3, 4)), np.empty((8, 3)), np.empty(4, np.int64)
    ranges[:] = np.inf
    for i in range(len(shape)):
        into_local(geometry[i], T_map_lidar, local)
        _corners(geometry[i], local, corners)
        _fan_window(corners, n_columns, el_min, el_step, n_rings, window)
        hx, hy, hz = geometry[i, HALF_X], geometry[i, HALF_Y], geometry[i, HALF_Z]
        for r in range(window[0], window[1]):
            for k in range(window[3]):
                c = (window[2] + k) % n_columns
                x, y, z = directions[r, c, 0], directions[r, c, 1], directions[r, c, 2]
                t = _hit(
                    shape[i], local[0, 3], local[1, 3], local[2, 3],
                    local[0, 0] * x + local[0, 1] * y + local[0, 2] * z,
                    local[1, 0] * x + local[1, 1] * y + local[1, 2] * z,
                    local[2, 0] * x + local[2, 1] * y + local[2, 2] * z,
                    hx, hy, hz,
                )  # fmt: skip
                ranges[r, c] = min(ranges[r, c], t)


@jit(error_model="numpy")
def rasterise(shape, geometry, z_lo, z_hi, origin_m, cell_m, grid):
    """Set `grid` (rows, columns) uint8 to 1 where a solid reaches into z_lo..z_hi [m].

    `origin_m` is x and y of the grid's corner, `cell_m` the side of a cell.
    """
    pad = 0.5 * cell_m  # a cell counts if its centre is within half a cell of the solid
    for i in range(len(shape)):
        z, hz, c, s = geometry[i, Z], geometry[i, HALF_Z], geometry[i, COS], geometry[i, SIN]
        if z - hz >= z_hi or z + hz <= z_lo:
            continue
        hx, hy = geometry[i, HALF_X] + pad, geometry[i, HALF_Y] + pad
        reach = math.hypot(hx, hy)
        x0, y0 = geometry[i, X] - origin_m[0], geometry[i, Y] - origin_m[1]
        for row in range(
            max(0, int((y0 - reach) / cell_m)), min(grid.shape[0], int((y0 + reach) / cell_m) + 1)
        ):
            for col in range(
                max(0, int((x0 - reach) / cell_m)),
                min(grid.shape[1], int((x0 + reach) / cell_m) + 1),
            ):
                x, y = (col + 0.5) * cell_m - x0, (row + 0.5) * cell_m - y0
                a, b = (c * x + s * y) / hx, (c * y - s * x) / hy
                inside = max(abs(a), abs(b)) <= 1.0 if shape[i] == BOX else a * a + b * b <= 1.0
                if inside:
                    grid[row, col] = 1
