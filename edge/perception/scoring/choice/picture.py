"""Set-of-marks: frontiers that the camera sees, and an image with their letters (ViTL fig. 3a).

A mark is such a frontier; in the image it has a letter. `visible_marks` finds the marks of a view,
`draw` shows them to a model that reads images.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from edge.geometry import invert
from edge.perception.scoring.choice.question import LETTERS, MAX_MARKS, Mark
from edge.types import Observation

ENLARGED_PX = 320  # smaller images are enlarged, so that letters do not cover too much
JPEG_QUALITY = 90
_RADIUS_SHARE = 0.035  # radius of a letter's disc, as a share of the image's longer side
_MIN_RADIUS_PX = 7
_RINGS = 24  # rings around a mark on which a free spot is looked for
_SPOKES = 24  # spots on each ring
NEAREST_M = 0.1  # least depth of a frontier; nearer ones, and those behind the camera, are left out
# A frontier is hidden if the depth image shows something nearer: by more than OCCLUDED_M plus
# OCCLUDED_SHARE of the frontier's depth. Smaller differences are the floor in front of it.
OCCLUDED_M = 0.3
OCCLUDED_SHARE = 0.1


def visible_marks(
    observation: Observation, xy_m: np.ndarray, ids: np.ndarray, limit: int = MAX_MARKS
) -> tuple[Mark, ...]:
    """Return the frontiers that the image shows, projected onto the floor (ViTL IV-B1).

    Frontiers behind the robot, outside the image, or hidden in the depth image are left out.

    Args:
        observation: camera, pose and depth.
        xy_m: (n, 2) frontiers in `map`.
        ids: (n,) ids of the frontiers' candidates.
        limit: largest number of marks; the nearest are taken.

    Returns:
        Marks from left to right; empty if the observation has no camera.
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
        # NaN and 0 mean no return.
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
    """Transform points (n, 2) on the robot's floor into the camera's optical frame, x, y and z."""
    # All points have the height of the robot's base, so a point is x_m * a + y_m * b + c.
    T = invert(T_map_base @ T_base_camera)
    a, b = T[:3, 0].tolist(), T[:3, 1].tolist()
    c = (T[:3, 2] * T_map_base[2, 3] + T[:3, 3]).tolist()
    x_m, y_m = xy_m[:, 0], xy_m[:, 1]
    x, y, z = (a[k] * x_m + b[k] * y_m + c[k] for k in range(3))
    return x, y, z


def scaled_copy(rgb: np.ndarray, least_px: int, max_px: int) -> tuple[np.ndarray, float]:
    """Return a copy of an image whose longer side has `least_px` to `max_px`, and its scale."""
    height, width = rgb.shape[:2]
    longer = max(width, height)
    scale = min(max(1.0, least_px / longer), max_px / longer)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR  # to shrink, or to enlarge
    return (rgb.copy() if scale == 1.0 else cv2.resize(rgb, size, interpolation=how)), scale


def draw(
    rgb: np.ndarray, marks: Sequence[Mark], max_px: int
) -> tuple[np.ndarray, tuple[Mark, ...]]:
    """Draw a letter at each mark, in a copy of the image.

    A letter whose spot is taken moves to the nearest free spot, with a line to its mark.

    Args:
        rgb: (h, w, 3) uint8.
        marks: from left to right, in pixels of `rgb`.
        max_px: longest side of the copy.

    Returns:
        The copy, and the marks with the letters A, B, … in this order. These are at most
        `MAX_MARKS`, without marks for which there was no room.
    """
    image, scale = scaled_copy(rgb, ENLARGED_PX, max_px)
    size = image.shape[1], image.shape[0]
    radius = max(_MIN_RADIUS_PX, round(_RADIUS_SHARE * max(size)))
    spots = [((m.u_px + 0.5) * scale - 0.5, (m.v_px + 0.5) * scale - 0.5) for m in marks]
    centers = place_discs(spots[:MAX_MARKS], size, radius)
    shown = [i for i, at in enumerate(centers) if at is not None]
    for i in shown:
        spot, at = _rounded(spots[i]), _rounded(centers[i])
        cv2.line(image, spot, at, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.line(image, spot, at, (255, 255, 255), 1, cv2.LINE_AA)
        cv2.circle(image, spot, 2, (255, 255, 255), -1, cv2.LINE_AA)
    for letter, i in zip(LETTERS, shown, strict=False):
        _draw_letter(image, letter, _rounded(centers[i]), radius)
    return image, tuple(marks[i] for i in shown)


def place_discs(
    spots: Sequence[tuple[float, float]], size: tuple[int, int], radius: int
) -> list[tuple[float, float] | None]:
    """Place discs as near to their spots as possible without overlap, in the order of the spots.

    Args:
        spots: (u, v) of each, in pixels.
        size: width and height of the image in pixels; discs stay inside.
        radius: radius of a disc in pixels.

    Returns:
        A centre for each spot, or None if there is no room.
    """
    taken: list[tuple[float, float]] = []
    centers: list[tuple[float, float] | None] = []
    apart = 2.0 * radius + 2.0  # 2 px for borders and rounding
    for spot in spots:
        free = (
            at
            for at in _around(spot, radius)
            if _fits(at, size, radius) and all(math.dist(at, other) >= apart for other in taken)
        )
        at = next(free, None)
        centers.append(at)
        if at is not None:
            taken.append(at)
    return centers


def data_url(rgb: np.ndarray) -> str:
    """Return an image as a JPEG in a `data:` URL."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()


def _around(spot: tuple[float, float], radius: int) -> Iterator[tuple[float, float]]:
    """Yield the spot, then positions on rings around it, nearest first."""
    yield spot
    for ring in range(1, _RINGS + 1):
        reach = 0.5 * ring * radius
        for spoke in range(_SPOKES):
            turn = 2.0 * math.pi * spoke / _SPOKES
            yield spot[0] + reach * math.sin(turn), spot[1] - reach * math.cos(turn)


def _fits(at: tuple[float, float], size: tuple[int, int], radius: int) -> bool:
    """Return True if a disc is inside the image."""
    return all(radius <= x <= side - 1 - radius for x, side in zip(at, size, strict=True))


def _rounded(at: tuple[float, float]) -> tuple[int, int]:
    return round(at[0]), round(at[1])


def _draw_letter(image: np.ndarray, letter: str, at: tuple[int, int], radius: int) -> None:
    """Draw a black letter on a white disc with a black border, in place."""
    cv2.circle(image, at, radius, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.circle(image, at, radius, (0, 0, 0), 1, cv2.LINE_AA)
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, max(1, radius // 6)
    (_, height), _ = cv2.getTextSize(letter, font, 1.0, thickness)
    scale = 1.1 * radius / height
    (width, height), _ = cv2.getTextSize(letter, font, scale, thickness)
    corner = (round(at[0] - width / 2), round(at[1] + height / 2))
    cv2.putText(image, letter, corner, font, scale, (0, 0, 0), thickness, cv2.LINE_AA)
