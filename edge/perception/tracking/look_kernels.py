"""Kernels that compute how well a known object should be visible in an image. Arrays only.

Only if it should be visible is a missing detection evidence that the object is not there.
"""

from __future__ import annotations

import numpy as np

from edge.geometry import CameraModel
from edge.jit import jit

LOOK_MIN_M = 1.0
"""Least distance of a reliable view: a nearer object does not fit into the image."""
LOOK_RIM = 0.1
"""Share of the image at each border in which a view is unreliable."""
OCCLUDED_M = 0.4
"""The object is hidden if the depth in its direction is less than its own by more than this."""
WHOLE_SHARE = 0.7
"""An object is wholly in the image if at least this share of its surface is."""

HIDDEN, AT_EDGE, IN_PART, WHOLE = range(4)
"""Visibility of an object.

HIDDEN: not in view. AT_EDGE: in an unreliable part of the view. IN_PART: well in view, but partly
cut off by the image's border. WHOLE: well in view as a whole."""

NO_DEPTH = np.zeros((1, 1), np.float32)
"""Placeholder for a missing depth image."""


def view_of(camera: CameraModel) -> np.ndarray:
    """Return the camera for the kernels: (fx, fy, cx, cy, width, height) in px, (6,) float64."""
    c = camera
    return np.array((c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.width_px, c.height_px), np.float64)


@jit
def ahead_m(T_camera_map, x, y, z):
    """Return the depth of a place in `map`, along the camera's axis, in metres."""
    T = T_camera_map
    return T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]


@jit
def visibility(x, y, z, points, n_points, T_camera_map, view, depth, far_m):
    """Return the visibility of an object: HIDDEN, AT_EDGE, IN_PART or WHOLE.

    Args:
        x: x of the object's centre in `map`.
        y: y of the centre.
        z: z of the centre.
        points: (k, 3) float32 in `map`, surface of the object.
        n_points: number of points that count; 0: the object is a point.
        T_camera_map: (4, 4) float64, optical frame from `map`.
        view: see `view_of`.
        depth: (h, w) float32, registered; `NO_DEPTH` if there is none.
        far_m: depth from which on nothing is in view.
    """
    T = T_camera_map
    fx, fy, cx, cy, width, height = view[0], view[1], view[2], view[3], view[4], view[5]
    zc = ahead_m(T, x, y, z)
    if not 0.1 < zc < far_m:  # behind the camera, at its lens, or too far
        return HIDDEN
    u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / zc + cx
    v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / zc + cy
    if not (0 <= u < width and 0 <= v < height):
        return HIDDEN
    if depth.shape[0] == height and depth.shape[1] == width:
        measured_m = depth[int(v), int(u)]  # 0 or NaN: no return
        if 0.0 < measured_m < zc - OCCLUDED_M:
            return HIDDEN
    rim_u, rim_v = LOOK_RIM * width, LOOK_RIM * height
    inside = rim_u < u < width - rim_u and rim_v < v < height - rim_v
    if not inside or zc <= LOOK_MIN_M:
        return AT_EDGE
    if n_points > 0 and share_in_view(points, n_points, T, view) < WHOLE_SHARE:
        return IN_PART
    return WHOLE


@jit
def share_in_view(points, n, T_camera_map, view):
    """Return the share of the first `n` > 0 points that are in the image.

    Args:
        points: (k, 3) float32 in `map`.
        n: number of points that count.
        T_camera_map: (4, 4) float64, optical frame from `map`.
        view: see `view_of`.
    """
    T = T_camera_map
    fx, fy, cx, cy, width, height = view[0], view[1], view[2], view[3], view[4], view[5]
    inside = 0
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        zc = ahead_m(T, x, y, z)
        if zc > 0.0:
            u = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / zc + cx
            v = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / zc + cy
            inside += 0.0 <= u < width and 0.0 <= v < height
    return inside / n
