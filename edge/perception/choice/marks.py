"""Which frontiers the camera sees, and where in the image."""

from __future__ import annotations

import numpy as np

from edge.geometry import invert
from edge.perception.choice.question import MAX_MARKS, Mark
from edge.types import Observation

NEAREST_M = 0.1
OCCLUDED_M, OCCLUDED_SHARE = 0.3, 0.1
"""A frontier lies on the floor at the edge of what was seen of it; a depth image that ends so much
in front of it, and this share of its distance, shows something that stands before it."""


def visible_marks(
    observation: Observation, xy_m: np.ndarray, ids: np.ndarray, limit: int = MAX_MARKS
) -> tuple[Mark, ...]:
    """The frontiers that the image shows, projected onto the floor (ViTL IV-B1).

    Behind the robot, outside the image and behind what the depth image shows there are none.

    Args:
        xy_m: (n, 2) frontiers in `map`.
        ids: (n,) their candidates' ids.
        limit: of more, the nearest are taken.

    Returns:
        From left to right; empty where the observation has no camera.
    """
    camera = observation.camera
    if camera is None or len(xy_m) == 0:
        return ()
    T_map_base = observation.T_map_base
    x, y, z = _in_camera(T_map_base, observation.T_base_camera, xy_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = camera.fx_px * x / z + camera.cx_px
        v = camera.fy_px * y / z + camera.cy_px
    width, height = camera.width_px, camera.height_px
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5) & (z > NEAREST_M)
    seen = np.flatnonzero(inside)
    depth = observation.depth_m
    if depth is not None and depth.shape == (height, width):
        depth_m = depth[np.rint(v[seen]).astype(np.intp), np.rint(u[seen]).astype(np.intp)]
        allowed_m = z[seen] * (1.0 - OCCLUDED_SHARE) - OCCLUDED_M
        # NaN and 0 mean that nothing returned.
        seen = seen[~((depth_m > 0.0) & (depth_m < allowed_m))]
    pose = observation.pose
    away_m = np.hypot(xy_m[seen, 0] - pose.x_m, xy_m[seen, 1] - pose.y_m)
    nearest = np.lexsort((ids[seen], away_m))[:limit]
    marks = [
        Mark(
            int(ids[i]), float(u[i]), float(v[i]),
            pose.bearing_to(float(xy_m[i, 0]), float(xy_m[i, 1])),
            pose.distance_to(float(xy_m[i, 0]), float(xy_m[i, 1])),
        )
        for i in seen[nearest]
    ]  # fmt: skip
    return tuple(sorted(marks, key=lambda mark: (mark.u_px, mark.id)))


def _in_camera(
    T_map_base: np.ndarray, T_base_camera: np.ndarray, xy_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the floor on which the robot stands, in the camera's optical frame."""
    T = invert(T_map_base @ T_base_camera)
    a, b = T[:3, 0].tolist(), T[:3, 1].tolist()
    c = (T[:3, 2] * T_map_base[2, 3] + T[:3, 3]).tolist()
    x_m, y_m = xy_m[:, 0], xy_m[:, 1]
    x, y, z = (a[k] * x_m + b[k] * y_m + c[k] for k in range(3))
    return x, y, z
