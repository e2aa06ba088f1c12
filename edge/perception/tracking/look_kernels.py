"""How well an image shows a thing whose place is known. Arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit

from edge.geometry import CameraModel

LOOK_MIN_M, LOOK_RIM, OCCLUDED_M = 1.0, 0.1, 0.4
"""What a look says little about: things nearer than that, which do not fit into the image, or in
that share of the image at its edge; and a return so much nearer hides what is behind it."""
MOST = 0.7
"""A thing is in the image as a whole where that share of its surface is."""

HIDDEN, AT_EDGE, IN_PART, WHOLE = range(4)
"""Not in view; in view where a look says little; well in view, but much of it cut off; well."""

NO_DEPTH = np.zeros((1, 1), np.float32)


def view_of(camera: CameraModel) -> np.ndarray:
    """What kernels need of a camera: (fx, fy, cx, cy, width, height) px, (6,) float64."""
    c = camera
    return np.array((c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.width_px, c.height_px), np.float64)


@njit(nogil=True, cache=True)
def ahead_m(T_camera_map, x, y, z):
    """How far before the camera a place in `map` lies, along its axis."""
    T = T_camera_map
    return T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]


@njit(nogil=True, cache=True)
def shown(x, y, z, points, n_points, T_camera_map, view, depth, far_m):
    """How well an image shows a thing: HIDDEN, AT_EDGE, IN_PART or WHOLE.

    Args:
        x, y, z: its middle in `map`; points: (k, 3) float32, of which the first `n_points` count,
            of its surface; where there are none, it is taken for a point.
        T_camera_map: (4, 4) float64, optical frame from `map`.
        view: see `view_of`.
        depth: (h, w) float32, registered; `NO_DEPTH` where there is none.
        far_m: from there on nothing is in view.
    """
    T = T_camera_map
    fx, fy, cx, cy, width, height = view[0], view[1], view[2], view[3], view[4], view[5]
    zc = ahead_m(T, x, y, z)
    if not 0.1 < zc < far_m:
        return HIDDEN
    u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / zc + cx
    v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / zc + cy
    if not (0 <= u < width and 0 <= v < height):
        return HIDDEN
    if depth.shape[0] == height and depth.shape[1] == width:
        there = depth[int(v), int(u)]
        if 0.0 < there < zc - OCCLUDED_M:
            return HIDDEN
    rim_u, rim_v = LOOK_RIM * width, LOOK_RIM * height
    inside = rim_u < u < width - rim_u and rim_v < v < height - rim_v
    if not inside or zc <= LOOK_MIN_M:
        return AT_EDGE
    if n_points > 0 and share_in_view(points, n_points, T, view) < MOST:
        return IN_PART
    return WHOLE


@njit(nogil=True, cache=True)
def share_in_view(points, n, T_camera_map, view):
    """Share of the first `n` > 0 of (k, 3) float32 points in `map` that lie in the image."""
    T = T_camera_map
    inside = 0
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        zc = ahead_m(T, x, y, z)
        if zc > 0.0:
            u = view[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / zc + view[2]
            v = view[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / zc + view[3]
            inside += 0.0 <= u < view[4] and 0.0 <= v < view[5]
    return inside / n
