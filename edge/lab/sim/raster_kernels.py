"""Rasteriser of triangles with hidden-surface removal, for `edge.lab.sim.mesh` (numba).

It finds the face that each pixel shows, as a ray through the middle of the pixel would. Faces come
in clusters, runs of faces with a box around them: clusters that are not in view, or hidden by what
is drawn already, are skipped.
"""

from __future__ import annotations

import math

import numpy as np

from edge.jit import jit

_NEAR_M = 1e-4  # corners nearer than this count as behind the camera
_SLACK_PX = 1e-3  # against rounding of a face's borders
_NARROW_PX = 4  # faces up to this width are tested pixel by pixel


@jit(error_model="numpy")
def bound_clusters(triangles, first, boxes):
    """Fill `boxes` (clusters, 6) with the lowest and the highest corner of each cluster.

    Cluster c has the faces from `first[c]` up to `first[c + 1]` of `triangles` (n, 3, 3).
    """
    for c in range(len(boxes)):
        for j in range(3):
            low, high = math.inf, -math.inf
            for f in range(first[c], first[c + 1]):
                for k in range(3):
                    low = min(low, triangles[f, k, j])
                    high = max(high, triangles[f, k, j])
            boxes[c, j], boxes[c, 3 + j] = low, high


@jit(error_model="numpy")
def _window(box, T_camera_map, fx, fy, cx, cy, height, width, out):
    """Fill `out` with the pixels and the least depth of a box; return True if it may be in view.

    `out` (5,): first and last column, first and last row, depth.
    """
    near, behind = math.inf, False
    u0, u1, v0, v1 = math.inf, -math.inf, math.inf, -math.inf
    T = T_camera_map
    for k in range(8):
        x, y, z = box[3 * (k & 1)], box[1 + 3 * ((k >> 1) & 1)], box[2 + 3 * (k >> 2)]
        depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        near = min(near, depth)
        if depth < _NEAR_M:
            behind = True
            continue
        u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth + cx
        v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth + cy
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if u0 > u1:
        return False  # all of it is behind the camera
    if behind:  # the rest may be anywhere
        u0, u1, v0, v1 = 0.0, width - 1.0, 0.0, height - 1.0
    out[0], out[1] = max(0.0, math.floor(u0)), min(width - 1.0, math.ceil(u1))
    out[2], out[3] = max(0.0, math.floor(v0)), min(height - 1.0, math.ceil(v1))
    out[4] = near
    return out[0] <= out[1] and out[2] <= out[3]


@jit(error_model="numpy")
def _is_hidden(window, inverse):
    """Return True if all pixels of a window show something nearer than the window's depth."""
    if window[4] < _NEAR_M:
        return False
    limit = 1.0 / window[4]
    for v in range(int(window[2]), int(window[3]) + 1):
        for u in range(int(window[0]), int(window[1]) + 1):
            if inverse[v, u] <= limit:
                return False
    return True


@jit(error_model="numpy")
def _narrow(first, last, base, per_slope):
    """Return the columns in which `base + column / per_slope` is not negative, and a bit more."""
    zero = max(-1e6, min(1e6, -base * per_slope))  # far outside, but small enough to round
    if per_slope > 0.0:
        return max(first, math.ceil(zero - _SLACK_PX)), last
    return first, min(last, math.floor(zero + _SLACK_PX))


@jit(error_model="numpy")
def _draw(triangles, f, T, fx, fy, cx, cy, p, n, inverse, face, weights):
    """Draw one face where it is nearest.

    With the corners p of the face in the camera's frame and the ray d through a pixel, the weights
    w of the hit point solve `w0 p0 + w1 p1 + w2 p2 = z d`. So `b = w / z` is linear in the pixel,
    and 1 / z is the sum of b; the pixel is inside if no b is negative. This also holds for faces
    that reach behind the camera.
    """
    height, width = inverse.shape
    behind = 0
    u0, u1, v0, v1 = math.inf, -math.inf, math.inf, -math.inf
    for k in range(3):
        x, y, z = triangles[f, k, 0], triangles[f, k, 1], triangles[f, k, 2]
        for j in range(3):
            p[k, j] = T[j, 0] * x + T[j, 1] * y + T[j, 2] * z + T[j, 3]
        if p[k, 2] < _NEAR_M:
            behind += 1
        else:
            u, v = fx * p[k, 0] / p[k, 2] + cx, fy * p[k, 1] / p[k, 2] + cy
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if behind == 3:
        return
    if behind:
        u0, u1, v0, v1 = 0.0, width - 1.0, 0.0, height - 1.0
    left, right = max(0.0, math.ceil(u0 - _SLACK_PX)), min(width - 1.0, math.floor(u1 + _SLACK_PX))
    top, bottom = max(0.0, math.ceil(v0 - _SLACK_PX)), min(height - 1.0, math.floor(v1 + _SLACK_PX))
    if left > right or top > bottom:
        return
    # Rows of the inverse of the matrix of the corners: cross products, divided by its determinant.
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        n[k, 0] = p[a, 1] * p[b, 2] - p[a, 2] * p[b, 1]
        n[k, 1] = p[a, 2] * p[b, 0] - p[a, 0] * p[b, 2]
        n[k, 2] = p[a, 0] * p[b, 1] - p[a, 1] * p[b, 0]
    volume = n[0, 0] * p[0, 0] + n[0, 1] * p[0, 1] + n[0, 2] * p[0, 2]
    if abs(volume) < 1e-18:
        return  # seen from its edge
    scale = 1.0 / volume
    ax, bx, cx_ = scale * n[0, 0] / fx, scale * n[1, 0] / fx, scale * n[2, 0] / fx
    # A slope of rounding errors gives no column.
    is_wide = right - left > _NARROW_PX and min(abs(ax), abs(bx), abs(cx_)) > 1e-12
    per_ax, per_bx, per_cx = 1.0 / ax, 1.0 / bx, 1.0 / cx_
    for v in range(int(top), int(bottom) + 1):
        y = (v - cy) / fy
        # b at column 0.
        a0 = scale * (n[0, 1] * y + n[0, 2]) - ax * cx
        b0 = scale * (n[1, 1] * y + n[1, 2]) - bx * cx
        c0 = scale * (n[2, 1] * y + n[2, 2]) - cx_ * cx
        first, last = left, right
        if is_wide:
            first, last = _narrow(first, last, a0, per_ax)
            first, last = _narrow(first, last, b0, per_bx)
            first, last = _narrow(first, last, c0, per_cx)
        for u in range(int(first), int(last) + 1):
            a, b, c = a0 + ax * u, b0 + bx * u, c0 + cx_ * u
            if a < 0.0 or b < 0.0 or c < 0.0:
                continue
            near = a + b + c
            if near > inverse[v, u]:
                inverse[v, u] = near
                face[v, u] = f
                weights[0, v, u], weights[1, v, u] = b, c  # times depth: see `rasterise_view`


@jit(error_model="numpy")
def rasterise_view(
    triangles, first, boxes, T_camera_map, fx, fy, cx, cy, inverse, face, weights, depth
):
    """Find the nearest face of each pixel.

    Args:
        triangles: (n, 3, 3) float32 corners in `map`.
        first: (clusters + 1,) int64, see `bound_clusters`.
        boxes: (clusters, 6) from `bound_clusters`.
        T_camera_map: (4, 4) transform to the camera's optical frame.
        fx: focal length [px].
        fy: focal length [px].
        cx: image centre [px].
        cy: image centre [px].
        inverse: (h, w) float64, used inside: 1 / depth.
        face: (h, w) int32, result: index of the face; -1 for none.
        weights: (2, h, w) float32, result: weights of the face's second and third corner.
        depth: (h, w) float32, result: z-depth, inf for none.
    """
    height, width = inverse.shape
    inverse[:] = 0.0
    face[:] = -1
    p, n, count = np.empty((3, 3)), np.empty((3, 3)), 0
    cluster, windows = np.empty(len(boxes), np.int64), np.empty((len(boxes), 5))
    for c in range(len(boxes)):
        if _window(boxes[c], T_camera_map, fx, fy, cx, cy, height, width, windows[count]):
            cluster[count] = c
            count += 1
    # The nearest clusters come first, so that they hide others.
    for i in np.argsort(windows[:count, 4]):
        c = cluster[i]
        if not _is_hidden(windows[i], inverse):
            for f in range(first[c], first[c + 1]):
                _draw(triangles, f, T_camera_map, fx, fy, cx, cy, p, n, inverse, face, weights)
    for v in range(height):
        for u in range(width):
            depth[v, u] = 1.0 / inverse[v, u]
            if face[v, u] >= 0:
                weights[0, v, u] *= depth[v, u]
                weights[1, v, u] *= depth[v, u]
