"""Colours of the pixels of a `BoxWorld`: textures by formula, and soft light (numba)."""

from __future__ import annotations

import math

import numpy as np

from edge.jit import jit
from edge.lab.sim.kernels import (
    BOX,
    COS,
    CYLINDER,
    ELLIPSOID,
    HALF_X,
    HALF_Y,
    HALF_Z,
    SIN,
    X,
    Y,
    Z,
    into_local,
)

# Textures of a primitive; `_texture` draws them.
PLAIN, PLANKS, TILES, FABRIC, GRAIN, PAINT, SCREEN, BOOKS, FOLIAGE, PICTURE = range(10)


@jit(error_model="numpy")
def _noise(a, b):
    """Return a repeatable pseudo-random number in [0, 1) from two integers."""
    n = (np.int64(a) * np.int64(374761393) + np.int64(b) * np.int64(668265263)) & 0x7FFFFFFF
    n = ((n ^ (n >> 13)) * 1274126177) & 0x7FFFFFFF
    return ((n ^ (n >> 16)) & 0xFFFF) / 65536.0


@jit(error_model="numpy")
def _line(a, period, width, blur):
    """Return the share in [0, 1] of a pixel at position `a` that a seam covers.

    The pixel has the size `blur`. Seams have width `width` and repeat every `period`; all in m.
    """
    from_seam = abs(a - period * math.floor(a / period + 0.5))
    reach = 0.5 * (width + blur)
    return 0.0 if from_seam > reach else min(1.0, width / (width + blur))


@jit(error_model="numpy")
def _texture(kind, a, b, px, py, pz, blur):
    """Return the factors of a texture on r, g, b, at the coordinates a, b [m] of a face.

    `kind` is one of PLAIN … PICTURE. Lengths in the formulas are in m: planks are 0.13 m wide.
    `px`, `py`, `pz` [m] are the same point in the primitive's frame. Detail smaller than the
    pixel's size `blur` [m] fades to its mean, to avoid aliasing.
    """
    if kind == PLANKS:
        row = math.floor(b / 0.13)
        shift = a + 0.53 * row
        tint = 0.84 + 0.26 * _noise(row, math.floor(shift / 1.1))
        grain = (_noise(math.floor(a / 0.25) + 31 * row, math.floor(b / 0.013)) - 0.5) * 0.1
        seam = max(_line(b, 0.13, 0.005, blur), _line(shift, 1.1, 0.005, blur))
        f = (tint + grain * min(1.0, 0.013 / blur)) * (1.0 - 0.45 * seam)
        return f, f * 0.985, f * 0.96
    if kind == TILES:
        tint = 0.93 + 0.09 * _noise(math.floor(a / 0.33 + 0.5), math.floor(b / 0.33 + 0.5))
        f = tint * (1.0 - 0.3 * max(_line(a, 0.33, 0.009, blur), _line(b, 0.33, 0.009, blur)))
        return f, f, f
    if kind == FABRIC:
        weave = _noise(math.floor(a / 0.012), math.floor(b / 0.012)) - 0.5
        f = 1.0 + 0.16 * weave * min(1.0, 0.012 / blur)
        return f, f, f
    if kind == GRAIN:
        ring = _noise(math.floor(b / 0.011), math.floor(a / 0.35 + 0.01 * b)) - 0.5
        f = 1.0 + 0.13 * ring * min(1.0, 0.011 / blur)
        return f, f * (1.0 - 0.02 * ring), f
    if kind == PAINT:
        f = 1.0 + 0.03 * (_noise(math.floor(a / 0.03), math.floor(b / 0.03)) - 0.5)
        return f, f, f
    if kind == SCREEN:
        f = 1.0 + 1.6 * max(0.0, math.sin(1.7 * a + 2.1 * b)) ** 6
        return f, f, f * 1.05
    if kind == BOOKS:
        book = math.floor(a / 0.035 + 400.0)
        gap = 1.0 - 0.6 * _line(a, 0.035, 0.006, blur)
        f = 0.45 + 0.25 * _noise(book, 3)
        return (
            gap * (f + 0.9 * _noise(book, 0)),
            gap * (f + 0.7 * _noise(book, 1)),
            gap * (f + 0.7 * _noise(book, 2)),
        )
    if kind == FOLIAGE:
        leaf = _noise(math.floor(px / 0.035) + 57 * math.floor(py / 0.035), math.floor(pz / 0.035))
        f = 0.55 + 0.8 * leaf
        return f * 0.95, f, f * 0.9
    if kind == PICTURE:
        x, y = math.floor(a / 0.11), math.floor(b / 0.11)
        return (
            0.35 + 0.75 * _noise(x, y),
            0.35 + 0.75 * _noise(x + 9, y),
            0.35 + 0.75 * _noise(x, y + 9),
        )
    return 1.0, 1.0, 1.0


@jit(error_model="numpy")
def _normal(shape, px, py, pz, hx, hy, hz):
    """Return nx, ny, nz of the outward normal at a surface point, and the axis nearest to it.

    All are in the primitive's own frame; `hx`, `hy`, `hz` are half of its extents.
    """
    x, y, z = px / hx, py / hy, pz / hz
    if shape == BOX:
        if abs(z) >= abs(x) and abs(z) >= abs(y):
            return 0.0, 0.0, math.copysign(1.0, z), 2
        if abs(x) >= abs(y):
            return math.copysign(1.0, x), 0.0, 0.0, 0
        return 0.0, math.copysign(1.0, y), 0.0, 1
    if shape == CYLINDER and z * z > x * x + y * y:
        return 0.0, 0.0, math.copysign(1.0, z), 2
    nx, ny, nz = x / hx, y / hy, (z / hz if shape == ELLIPSOID else 0.0)
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale, (0 if abs(nx) > abs(ny) else 1)


@jit(error_model="numpy")
def shade(
    shape, geometry, color, texture, T_map_camera, fx, fy, cx, cy, depth, prim,
    clearance_m, origin_m, cell_m, sky, rgb,
):  # fmt: skip
    """Fill `rgb` (h, w, 3) uint8 with the colours of the pixels that `render_depth` has found.

    The light comes from above, and also brightens faces that are turned away from it
    (half-Lambert). The floor next to obstacles, and the foot of upright faces, are darker, as in
    the shadow of a contact.

    Each of the n primitives has its shape and geometry (`edge.lab.sim.kernels`), a colour (n, 3)
    float32 of 0 to 255, and a texture (n,) uint8. Depth and primitive (h, w) of each pixel are from
    `render_depth`. `clearance_m` is the distance to the nearest obstacle on the floor plan (rows,
    columns), whose corner is `origin_m`. `sky` (3,) uint8 is the colour of pixels that show
    nothing.
    """
    height, width = depth.shape
    local = np.empty((3, 4))
    last = -1
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            i = prim[v, u]
            if i < 0:
                rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2] = sky[0], sky[1], sky[2]
                continue
            if i != last:
                into_local(geometry[i], T_map_camera, local)
                last = i
            # The point in the primitive's frame.
            t = float(depth[v, u])
            x = (u - cx) / fx
            px = local[0, 3] + t * (local[0, 0] * x + local[0, 1] * y + local[0, 2])
            py = local[1, 3] + t * (local[1, 0] * x + local[1, 1] * y + local[1, 2])
            pz = local[2, 3] + t * (local[2, 0] * x + local[2, 1] * y + local[2, 2])
            hx, hy, hz = geometry[i, HALF_X], geometry[i, HALF_Y], geometry[i, HALF_Z]
            nx, ny, nz, axis = _normal(shape[i], px, py, pz, hx, hy, hz)
            c, s = geometry[i, COS], geometry[i, SIN]
            # The normal in `map`, times the direction of the light.
            light = 0.80 + 0.20 * (0.30 * (c * nx - s * ny) + 0.42 * (s * nx + c * ny) + 0.86 * nz)
            z = pz + geometry[i, Z]  # height above the floor
            a, b = px, py  # coordinates on the face
            if axis != 2:  # an upright face; else one that faces up or down
                a, b = (py, pz) if axis == 0 else (px, pz)
                light *= 0.84 + 0.16 * min(1.0, max(0.0, z) / 0.35)
            elif z < 0.02:
                col = int((c * px - s * py + geometry[i, X] - origin_m[0]) / cell_m)
                row = int((s * px + c * py + geometry[i, Y] - origin_m[1]) / cell_m)
                if 0 <= row < clearance_m.shape[0] and 0 <= col < clearance_m.shape[1]:
                    light *= 0.66 + 0.34 * min(1.0, clearance_m[row, col] / 0.3)
            # At a grazing angle a pixel covers more of the surface.
            fr, fg, fb = _texture(texture[i], a, b, px, py, pz, 1.5 * t / fx + 1e-6)
            rgb[v, u, 0] = np.uint8(min(255.0, color[i, 0] * light * fr))
            rgb[v, u, 1] = np.uint8(min(255.0, color[i, 1] * light * fg))
            rgb[v, u, 2] = np.uint8(min(255.0, color[i, 2] * light * fb))


@jit(error_model="numpy")
def bake(kind, texel_m, out):
    """Fill `out` (n, n, 3) float32 with a texture's colour factors, one texel per `texel_m`."""
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            a, b = col * texel_m, row * texel_m
            out[row, col] = _texture(kind, a, b, a, b, 0.0, texel_m)
