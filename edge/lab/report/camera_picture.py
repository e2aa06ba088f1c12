"""A trajectory drawn into the camera image: the strip of ground that the robot will drive over."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from edge.geometry import CameraModel, invert
from edge.tasks.scene.scene import Scene
from edge.trajectory.speeds import headings_rad

COARSE_RGB, REFINED_RGB = (240, 140, 0), (214, 34, 91)  # of the two trajectories
NEAREST_M = 0.3
"""Parts of the trajectory that are nearer to the camera are cut off."""
COVER = 0.5
"""Opacity of the strip."""
HIDDEN_COVER = 0.16
"""Opacity of the strip behind an object."""
LEAST_PX = 1280
"""Narrower images are enlarged to this width."""
_POSES_PER_PIECE = 3
"""Number of steps of the trajectory that one drawn piece of the strip spans."""
_WHITE = (255, 255, 255)


def draw_trajectory(
    scene: Scene, coarse_m: np.ndarray | None, refined_m: np.ndarray | None, half_m: float
) -> np.ndarray | None:
    """Return the scene's image with a trajectory in it, (h, w, 3) uint8; None if it has no image.

    Points are (n, 3) float64 in `map`: the coarse trajectory becomes a dashed line, and the refined
    one a strip, `half_m` (the robot's radius) to each side. None: there is no such trajectory.
    """
    if scene.rgb is None or scene.camera is None or scene.T_map_camera is None:
        return None
    scale = max(1.0, LEAST_PX / scene.camera.width_px)
    size = round(scene.camera.width_px * scale), round(scene.camera.height_px * scale)
    image = scene.rgb.copy() if scale == 1.0 else cv2.resize(scene.rgb, size)
    if refined_m is not None and len(refined_m) > 1:
        _draw_strip(image, scene, refined_m, half_m, scale)
    if coarse_m is not None and len(coarse_m) > 1:
        for a, b in _pieces(coarse_m, 0.5)[::2]:  # every second piece: a dashed line
            ends = _pixels(scene, np.stack([a, b]), scale)
            if len(ends) == 2:  # 0 if both are behind the camera
                cv2.line(image, *ends.tolist(), COARSE_RGB, 2, cv2.LINE_AA)
    if refined_m is not None and len(refined_m):
        _draw_end_ring(image, scene, refined_m[-1], half_m, scale)
    return image


def _draw_strip(
    image: np.ndarray, scene: Scene, refined_m: np.ndarray, half_m: float, scale: float
) -> None:
    """Draw the strip from far to near, so that nearer parts are on top."""
    heading = headings_rad(refined_m[:, :2])
    side_m = half_m * np.stack([-np.sin(heading), np.cos(heading), 0 * heading], axis=1)
    # The strip is cut into pieces at these indices.
    seams = np.unique(np.append(np.arange(0, len(refined_m), _POSES_PER_PIECE), len(refined_m) - 1))
    eye = scene.T_map_camera[:3, 3]
    visible, faint = np.zeros(image.shape[:2], np.uint8), np.zeros(image.shape[:2], np.uint8)
    for i, k in zip(seams[:-1].tolist(), seams[1:].tolist(), strict=True):
        corners = np.stack(
            [refined_m[i] + side_m[i], refined_m[k] + side_m[k], refined_m[k] - side_m[k],
             refined_m[i] - side_m[i]]
        )  # fmt: skip
        outline = _pixels(scene, corners, scale)
        if len(outline) < 3:
            continue
        middle = 0.5 * (refined_m[i] + refined_m[k])
        hidden = _is_hidden(scene, middle, float(np.linalg.norm(middle - eye)))
        cv2.fillPoly(faint if hidden else visible, [outline], 255, cv2.LINE_AA)
    cover = np.maximum(COVER * visible, HIDDEN_COVER * faint)[..., None] / 255.0
    image[:] = (image * (1.0 - cover) + np.array(REFINED_RGB) * cover).astype(np.uint8)


def _draw_end_ring(
    image: np.ndarray, scene: Scene, end_m: np.ndarray, half_m: float, scale: float
) -> None:
    """Draw a ring on the ground at the end of the trajectory."""
    turn = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = end_m + half_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    outline = _pixels(scene, ring, scale)
    if len(outline) > 2:
        cv2.polylines(image, [outline], True, _WHITE, 4, cv2.LINE_AA)
        cv2.polylines(image, [outline], True, REFINED_RGB, 2, cv2.LINE_AA)


def _is_hidden(scene: Scene, point_m: np.ndarray, distance_m: float) -> bool:
    """Return True if an object that is nearer than `distance_m` covers a point."""
    at = _pixels(scene, point_m[None], 1.0)
    if not len(at):
        return False
    eye = scene.T_map_camera[:3, 3]
    for number, outlines in scene.contours.items():
        item = scene.objects[number]
        nearest_m = np.linalg.norm(item.points_m - eye, axis=1).min(initial=np.inf)
        inside = any(cv2.pointPolygonTest(o, at[0].tolist(), False) >= 0 for o in outlines)
        if inside and nearest_m < distance_m:
            return True
    return False


def _pixels(scene: Scene, points_m: np.ndarray, scale: float) -> np.ndarray:
    """Project the part of a polygon, a line or a point that is in front of the camera.

    `points_m` (n, 3) in `map` are the corners of a polygon, 2 ends of a line, or 1 point. `scale`
    enlarges the image.

    Returns:
        (k, 2) int32 pixels: the corners of the visible part. Both ends of a line, or the point;
            empty if nothing is in front of the camera.
    """
    camera: CameraModel = scene.camera
    T_camera_map = invert(scene.T_map_camera)
    front = _clip_to_front(points_m @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])
    if not len(front):
        return np.zeros((0, 2), np.int32)
    u = camera.fx_px * front[:, 0] / front[:, 2] + camera.cx_px + 0.5
    v = camera.fy_px * front[:, 1] / front[:, 2] + camera.cy_px + 0.5
    limit = 8.0 * max(camera.width_px, camera.height_px)  # OpenCV counts in 32 bits
    return np.rint(scale * np.clip(np.stack([u, v], axis=1), -limit, limit)).astype(np.int32)


def _clip_to_front(polygon: np.ndarray) -> np.ndarray:
    """Return the part of a polygon (n, 3) in the optical frame that is in front of the camera.

    Clips at one plane (Sutherland & Hodgman 1974).
    """
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        ahead = a[2] >= NEAREST_M, b[2] >= NEAREST_M
        if ahead[0]:
            out.append(a)
        if ahead[0] != ahead[1]:
            out.append(a + (NEAREST_M - a[2]) / (b[2] - a[2]) * (b - a))
    return np.array(out).reshape(-1, 3)


def _pieces(line_m: np.ndarray, length_m: float) -> Sequence[tuple[np.ndarray, np.ndarray]]:
    """Cut a polyline into pieces of about `length_m`; return the two ends of each."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line_m, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], max(2, round(along[-1] / length_m) + 1))
    points = np.stack([np.interp(at, along, axis) for axis in line_m.T], axis=1)
    return list(pairwise(points))
