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
    floor = np.full((len(xy_m), 4), [0.0, 0.0, T_map_base[2, 3], 1.0])
    floor[:, :2] = xy_m
    x, y, z, _ = invert(T_map_base @ observation.T_base_camera) @ floor.T
    seen = np.flatnonzero(z > NEAREST_M)
    u = camera.fx_px * x[seen] / z[seen] + camera.cx_px
    v = camera.fy_px * y[seen] / z[seen] + camera.cy_px
    column, row = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
    inside = (column >= 0) & (column < camera.width_px) & (row >= 0) & (row < camera.height_px)
    depth = observation.depth_m
    if depth is not None and depth.shape == (camera.height_px, camera.width_px):
        depth_m = depth[row[inside], column[inside]]
        allowed_m = z[seen[inside]] * (1.0 - OCCLUDED_SHARE) - OCCLUDED_M
        # NaN and 0 mean that nothing returned.
        inside[inside] = ~((depth_m > 0.0) & (depth_m < allowed_m))
    pose = observation.pose
    marks = [
        Mark(
            int(ids[i]), float(u[k]), float(v[k]),
            pose.bearing_to(float(xy_m[i, 0]), float(xy_m[i, 1])),
            pose.distance_to(float(xy_m[i, 0]), float(xy_m[i, 1])),
        )
        for k, i in zip(np.flatnonzero(inside), seen[inside], strict=True)
    ]  # fmt: skip
    nearest = sorted(marks, key=lambda mark: (mark.distance_m, mark.id))[:limit]
    return tuple(sorted(nearest, key=lambda mark: (mark.u_px, mark.id)))
