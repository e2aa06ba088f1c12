"""Projection of masks in the picture to LiDAR points, without the background (OpenNav eq. 2)."""

from __future__ import annotations

import numpy as np

from edge.geometry import CameraModel
from edge.tasks.scene import scan_kernels as kernels
from edge.tasks.scene.objects import clusters
from edge.types import MASK_SIDE

MARGIN_SHARE = 0.25
"""Width of a margin around each box, as a share of the box's size.

The window is the box with this margin, which shows the background next to the object."""
GAP_M, GAP_SHARE = 0.5, 0.015
"""Surfaces are separated by a jump in depth of more than `GAP_M` plus `GAP_SHARE` of the depth.

Scan lines on one surface are farther apart at a greater distance. A surface at a grazing angle is
cut where the returns of one column are too far apart: at 20 m below 4 deg with a column every 0.17
deg, as a LiDAR of 64 rings has, and below 13 deg with a column every 0.5 deg.
"""
LEAST_SPAN = 0.2
"""Smallest share of a box's width and height that the points must cover, without a mask.

Fewer points belong to something else in the box, such as the hedge in front of a house that is
higher than the LiDAR's field of view.
"""
ON_MASK_SHARE = 0.5
"""A cluster in the window belongs to the object if this share of its points is on the mask."""
_NO_MASKS = np.zeros((0, MASK_SIDE, MASK_SIDE), np.bool_)


def points_of_masks(
    cloud_m: np.ndarray,
    T_camera_cloud: np.ndarray,
    camera: CameraModel,
    xyxy_px: np.ndarray,
    mask: np.ndarray | None = None,
    keep: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Return the points of each object in a picture: the points in its mask without the background.

    A mask also shows some background. The points are split where their depth jumps. The part whose
    picture fits the mask best is taken (see `scan_kernels.best_surface`). Trees before a building
    cut it into several parts, so each cluster that is mostly on the mask is taken, too. A box
    without a mask has one part, and none if that covers only a corner of the box.

    Args:
        cloud_m: (n, 3) float32; points that are not finite are ignored.
        T_camera_cloud: (4, 4) float64, from the cloud's frame to the optical frame: M_T.
        camera: intrinsics: M_K.
        xyxy_px: (k, 4) float32 boxes.
        mask: (k, MASK_SIDE, MASK_SIDE) bool, see `Detections.mask`. A box with an empty mask, or
            every box if this is None, is its own mask.
        keep: (n,) bool, points to use, such as those above the ground; None: all.

    Returns:
        For each box indices into `cloud_m`, int32, ascending; empty if no point is on the object.
    """
    k, n = len(xyxy_px), len(cloud_m)
    if k == 0 or n == 0:
        return [np.zeros(0, np.int32) for _ in range(k)]
    masks, has_mask = _NO_MASKS, np.zeros(k, np.bool_)
    if mask is not None:
        has_mask = mask.any(axis=(1, 2))
        masks = np.where(has_mask[:, None, None], mask, True)
    intrinsics = (
        float(camera.width_px), float(camera.height_px),
        camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px,
    )  # fmt: skip
    keep = np.ones(n, np.bool_) if keep is None else keep
    boxes = np.ascontiguousarray(xyxy_px, np.float32)
    capacity = n
    while True:
        mask_of, point_of = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        depth_m = np.empty(capacity, np.float32)
        found = kernels.points_of_windows(
            cloud_m,
            T_camera_cloud,
            intrinsics,
            boxes,
            masks,
            MARGIN_SHARE,
            keep,
            mask_of,
            point_of,
            depth_m,
        )
        if found <= capacity:
            break
        capacity = found
    mask_of, point_of, depth_m = mask_of[:found], point_of[:found], depth_m[:found]
    on_mask = mask_of >= 0
    window = np.where(on_mask, mask_of, -1 - mask_of)  # see `points_of_windows`
    order = np.lexsort((depth_m, window))
    ends = np.searchsorted(window[order], np.arange(k + 1))
    out = []
    for i in range(k):
        in_window = order[ends[i] : ends[i + 1]]
        first, last = kernels.best_surface(depth_m[in_window], on_mask[in_window], GAP_M, GAP_SHARE)
        chosen = np.zeros(len(in_window), np.bool_)
        chosen[first:last] = True
        if has_mask[i] and len(in_window):
            depth = depth_m[in_window]
            right_m = cloud_m[point_of[in_window]] @ T_camera_cloud[0, :3].astype(np.float32)
            reach_m = GAP_M + GAP_SHARE * float(np.median(depth))
            for group in clusters(np.column_stack((right_m, depth)), reach_m):
                chosen[group] |= on_mask[in_window[group]].mean() >= ON_MASK_SHARE
        points = np.sort(point_of[in_window[chosen & on_mask[in_window]]])
        covers = has_mask[i] or (
            len(points) and _covers_box(cloud_m[points], T_camera_cloud, camera, boxes[i])
        )
        out.append(points if covers else points[:0])
    return out


def _covers_box(
    points_m: np.ndarray, T_camera_cloud: np.ndarray, camera: CameraModel, box: np.ndarray
) -> bool:
    """Return True if the picture of some points covers enough of the visible part of a box."""
    at_px, _ = in_picture(points_m, T_camera_cloud, camera)
    sides = np.array([camera.width_px, camera.height_px], np.float64)
    inside = np.clip(box[2:], 0.0, sides) - np.clip(box[:2], 0.0, sides)
    return bool((np.ptp(at_px, axis=0) >= LEAST_SPAN * inside).all())


def in_picture(
    cloud_m: np.ndarray, T_camera_cloud: np.ndarray, camera: CameraModel
) -> tuple[np.ndarray, np.ndarray]:
    """Project points into a picture: M_K M_T l of eq. 2.

    Returns:
        (n, 2) float64 u and v in pixels from the corner of the picture, as for boxes, and (n,)
        bool, True if the point is inside the picture.
    """
    T = T_camera_cloud
    x, y, z = (cloud_m @ T[:3, :3].T + T[:3, 3]).astype(np.float64).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u = camera.fx_px * x / z + camera.cx_px + 0.5
        v = camera.fy_px * y / z + camera.cy_px + 0.5
        shown = (z > kernels.NEAREST_M) & (u >= 0.0) & (v >= 0.0)
        shown &= (u < camera.width_px) & (v < camera.height_px)
    return np.stack((u, v), axis=1), shown
