"""Shading and rasterising of textured triangles, for `edge.lab.sim.mesh` (numba).

A texel is a pixel of a texture. `uvs` are positions in a texture: s to the right, t down, 0 to 1.
Textures are one after another in `texels` (n, 3) uint8, each with all its smaller copies (halved
until one texel is left). `levels` (m, 3) int64 holds offset, height, width of each copy.
`first_level` (faces,) is the largest copy of a face's texture, and `level_count` the number of its
copies.
"""

from __future__ import annotations

import math

import numpy as np

from edge.jit import jit


@jit(error_model="numpy")
def aim(rays, T_map_sensor, origins, directions):
    """Transform `rays` (n, 3), directions in a sensor's frame, to `map`.

    Fills `origins` and `directions`, (n, 3) float32. This is not a matrix product: BLAS would start
    threads for it, which spin while they wait.
    """
    T = T_map_sensor
    for k in range(len(rays)):
        x, y, z = rays[k, 0], rays[k, 1], rays[k, 2]
        for j in range(3):
            origins[k, j] = T[j, 3]
            directions[k, j] = T[j, 0] * x + T[j, 1] * y + T[j, 2] * z


@jit(error_model="numpy")
def _sample(texels, offset, height, width, s, t):
    """Return r, g, b of a texture at s (right), t (down): the mean of four texels (bilinear).

    Positions outside 0 to 1 repeat the texture. The copy has `height` rows and begins at `offset`.
    """
    x, y = (s - math.floor(s)) * width - 0.5, (t - math.floor(t)) * height - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    x1 = 0 if x0 + 1 >= width else x0 + 1
    y1 = 0 if y0 + 1 >= height else y0 + 1
    # x, y >= -0.5, and a wrapped 1.0 may round up to the width.
    x0 = width - 1 if x0 < 0 else min(x0, width - 1)
    y0 = height - 1 if y0 < 0 else min(y0, height - 1)
    i00, i10 = offset + y0 * width + x0, offset + y0 * width + x1
    i01, i11 = offset + y1 * width + x0, offset + y1 * width + x1
    w00, w10, w01, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        w00 * texels[i00, 0] + w10 * texels[i10, 0] + w01 * texels[i01, 0] + w11 * texels[i11, 0],
        w00 * texels[i00, 1] + w10 * texels[i10, 1] + w01 * texels[i01, 1] + w11 * texels[i11, 1],
        w00 * texels[i00, 2] + w10 * texels[i10, 2] + w01 * texels[i01, 2] + w11 * texels[i11, 2],
    )


@jit(error_model="numpy")
def shade_hits(
    face, u, v, distance, rays, fx,
    normals, uvs, tint, texels, levels, first_level, level_count, texel_density, sky, rgb,
):  # fmt: skip
    """Fill rgb (n, 3) uint8 for n rays' first hits.

    `face` (n,) is the index of the face, -1 for none; `u` and `v` (n,) are the weights of the
    face's second and third corner at the point; `distance` (n,) is in lengths of the ray. `rays`
    (n, 3) float32 are in the map frame with z-depth 1, so `distance` is the depth. `fx` is the
    focal length [px]. `normals` (faces, 3, 3) are at the corners, of any length; `uvs` is
    (faces, 3, 2). `tint` (faces, 3) is in 0..1; `texel_density` (faces,) is in texels per metre of
    the largest copy. `sky` (3,) is the colour for no face.
    """
    for k in range(len(face)):
        f = face[k]
        if f < 0:
            rgb[k, 0], rgb[k, 1], rgb[k, 2] = sky[0], sky[1], sky[2]
            continue
        z, b1, b2 = distance[k], u[k], v[k]
        b0 = 1.0 - b1 - b2
        s = b0 * uvs[f, 0, 0] + b1 * uvs[f, 1, 0] + b2 * uvs[f, 2, 0]
        t = b0 * uvs[f, 0, 1] + b1 * uvs[f, 1, 1] + b2 * uvs[f, 2, 1]
        # Take the copy in which a texel is about as large as the pixel. The footprint is the
        # number of texels along a pixel; 1.42 is the square root of 2, halfway to the next copy.
        footprint, level = texel_density[f] * z / fx, first_level[f]
        last = level + level_count[f] - 1
        while footprint > 1.42 and level < last:
            footprint *= 0.5
            level += 1
        r, g, b = _sample(texels, levels[level, 0], levels[level, 1], levels[level, 2], s, t)
        nx = b0 * normals[f, 0, 0] + b1 * normals[f, 1, 0] + b2 * normals[f, 2, 0]
        ny = b0 * normals[f, 0, 1] + b1 * normals[f, 1, 1] + b2 * normals[f, 2, 1]
        nz = b0 * normals[f, 0, 2] + b1 * normals[f, 1, 2] + b2 * normals[f, 2, 2]
        dx, dy, dz = rays[k, 0], rays[k, 1], rays[k, 2]
        facing = nx * dx + ny * dy + nz * dz
        # Triangles are visible from both sides: times `scale`, the normal faces the camera and
        # has length 1.
        scale = -math.copysign(1.0, facing) / math.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        # Cosine of the angle between this normal and the line to the camera.
        head = -facing * scale / math.sqrt(dx * dx + dy * dy + dz * dz)
        # Ambient light, a lamp at the camera, and light from above.
        light = 0.66 + 0.24 * head + 0.14 * scale * (0.3 * nx + 0.42 * ny + 0.86 * nz)
        rgb[k, 0] = np.uint8(min(255.0, r * tint[f, 0] * light))
        rgb[k, 1] = np.uint8(min(255.0, g * tint[f, 1] * light))
        rgb[k, 2] = np.uint8(min(255.0, b * tint[f, 2] * light))


@jit(error_model="numpy")
def rasterise_triangles(triangles, z_lo, z_hi, origin_m, cell_m, grid):
    """Set `grid` to 1 under every part of the (n, 3, 3) triangles between z_lo and z_hi [m].

    Samples are less than half a cell apart, so no crossed cell is missed by more than that.
    """
    step = 0.5 * cell_m
    for k in range(len(triangles)):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        if max(a[2], b[2], c[2]) < z_lo or min(a[2], b[2], c[2]) > z_hi:
            continue
        ab, ac = b - a, c - a
        longest = max(np.sqrt((ab * ab).sum()), np.sqrt((ac * ac).sum()))
        longest = max(longest, np.sqrt(((c - b) * (c - b)).sum()))
        count = int(longest / step) + 1
        for i in range(count + 1):
            for j in range(count + 1 - i):
                p, q = i / count, j / count
                z = a[2] + p * ab[2] + q * ac[2]
                if z < z_lo or z > z_hi:
                    continue
                col = math.floor((a[0] + p * ab[0] + q * ac[0] - origin_m[0]) / cell_m)
                row = math.floor((a[1] + p * ab[1] + q * ac[1] - origin_m[1]) / cell_m)
                if 0 <= row < grid.shape[0] and 0 <= col < grid.shape[1]:
                    grid[row, col] = 1
