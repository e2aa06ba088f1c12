"""Points and boxes of one frame: an observation with a cloud or depth, and its picture."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from edge.geometry import invert
from edge.tasks.scene.projection import in_picture, points_of_masks
from edge.types import Detections, Observation

_MARGIN_SHARE = 0.05
"""A point is clearly outside a box at this share of the box's size plus one pixel from it."""
MAX_RANGE_M = 300.0
"""Points beyond this are an error of the sensor or the file."""
MAX_DEPTH_POINTS = 60_000  # of a depth image; a larger one is thinned
MASK_SCALE = 4
"""Factor by which masks are enlarged before contours are drawn, for finer corners."""


def cloud_of(observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return the observation's points (n, 3) float32 and their pose T_base_cloud.

    The points are those of the LiDAR, else of the depth image.

    Raises:
        ValueError: it has neither, or the depth image does not fit its camera.
    """
    if observation.cloud_m is not None:
        return observation.cloud_m, observation.T_base_lidar
    depth, camera = observation.depth_m, observation.camera
    if depth is None or camera is None or depth.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"observation {observation.seq}: it has neither a cloud nor a depth image of the same "
            "size as the camera's"
        )
    stride = max(1, int(np.ceil(np.sqrt(depth.size / MAX_DEPTH_POINTS))))
    z = depth[::stride, ::stride]
    v, u = np.nonzero((z > 0.0) & np.isfinite(z))
    z = z[v, u]
    x = (u * stride - camera.cx_px) / camera.fx_px * z
    y = (v * stride - camera.cy_px) / camera.fy_px * z
    return np.stack((x, y, z), axis=1).astype(np.float32), observation.T_base_camera


def points_within(cloud_m: np.ndarray, range_m: float = MAX_RANGE_M) -> np.ndarray:
    """Return the points (n, 3) of a scan that are finite and within a range, (n,) bool."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.linalg.norm(cloud_m, axis=1) <= range_m


def transformed(T: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Transform points to another frame, (n, 3) float32."""
    return points_m @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)


def points_in_boxes(
    found: Detections, cloud_m: np.ndarray, T_base_cloud: np.ndarray, keep: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the points of each box's object, as indices into the cloud, and the area of the box.

    `keep` is (n,) bool, the points to use.
    """
    observation = found.observation
    T_camera_cloud = invert(observation.T_base_camera) @ T_base_cloud
    in_boxes = points_of_masks(
        cloud_m, T_camera_cloud, observation.camera, found.xyxy_px, found.mask, keep
    )
    return zip(in_boxes, areas_px2(found).tolist(), strict=True)


def areas_px2(found: Detections) -> np.ndarray:
    """Return the area of each box, (n,) float32."""
    return np.prod(found.xyxy_px[:, 2:] - found.xyxy_px[:, :2], axis=1)


def outside_boxes(
    found: Detections, label: str, cloud_m: np.ndarray, T_base_cloud: np.ndarray
) -> np.ndarray:
    """Return the points in the picture that are clearly outside every box of a label, (n,) bool."""
    observation = found.observation
    T_camera_cloud = invert(observation.T_base_camera) @ T_base_cloud
    at_px, outside = in_picture(cloud_m, T_camera_cloud, observation.camera)
    u, v = at_px.T
    for box_px, k in zip(found.xyxy_px, found.class_id, strict=True):
        if found.prompts[k] == label:
            x0, y0, x1, y1 = box_px.tolist()
            mx, my = _MARGIN_SHARE * (x1 - x0) + 1.0, _MARGIN_SHARE * (y1 - y0) + 1.0
            outside &= (u < x0 - mx) | (u > x1 + mx) | (v < y0 - my) | (v > y1 + my)
    return outside


def has_mask(found: Detections, i: int) -> bool:
    """Return True if box i has a mask that is not empty."""
    return found.mask is not None and bool(found.mask[i].any())


def contours_of(found: Detections, i: int) -> list[np.ndarray]:
    """Return the outlines of box i's mask, or of the box if it has none: (k, 2) int32 polygons."""
    x0, y0, x1, y1 = found.xyxy_px[i]
    if found.mask is None or not found.mask[i].any():
        return [np.rint([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]).astype(np.int32)]
    mask = np.kron(found.mask[i], np.ones((MASK_SCALE, MASK_SCALE), np.bool_)).astype(np.uint8)
    lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    scale = np.array([(x1 - x0) / mask.shape[1], (y1 - y0) / mask.shape[0]])
    corner = np.array([x0, y0])
    return [np.rint(corner + line[:, 0] * scale).astype(np.int32) for line in lines]
