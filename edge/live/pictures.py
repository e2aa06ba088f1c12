"""Maps and camera images as JSON for the live page."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np

from edge.geometry import Grid, downsample
from edge.live.sink import CameraShot

MAX_SIDE = 1600
"""Largest side of a map in pixels."""
JPEG_QUALITY = 75
_FAST = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def grid_json(grid: Grid) -> dict[str, Any]:
    """Return a map as JSON: pose, cell size, and the cells as a grey PNG in base64.

    Row 0 of the picture is the lowest y. Occupancy -1 becomes 255. A grid with a side over
    `MAX_SIDE` cells is made coarser.
    """
    grid = downsample(grid, MAX_SIDE)
    height, width = grid.cells.shape
    return {
        "origin_xy_m": list(map(float, grid.origin_xy_m)),
        "resolution_m": grid.resolution_m,
        "size": [width, height],
        "png": _encode(".png", grid.cells.view(np.uint8), _FAST),
    }


def shot_json(shot: CameraShot) -> dict[str, Any]:
    """Return a camera image as JSON: a JPEG in base64, boxes, and the letters that mark directions.

    Positions of boxes and letters are fractions of the image's width and height.
    """
    height, width = shot.rgb.shape[:2]
    bgr = cv2.cvtColor(shot.rgb, cv2.COLOR_RGB2BGR)
    return {
        "seq": shot.seq,
        "size": [width, height],
        "boxes": [
            {
                "label": box.label,
                "score": round(box.score, 3),
                "wanted": box.wanted,
                "xyxy": [round(share, 4) for share in box.xyxy],
            }
            for box in shot.boxes
        ],
        "letters": [[letter, round(u, 4), round(v, 4)] for letter, u, v in shot.marks],
        "jpeg": _encode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]),
    }


def _encode(kind: str, image: np.ndarray, options: list[int]) -> str:
    """Return an image in base64; "" if it has no pixels."""
    if image.size == 0:
        return ""
    return base64.b64encode(cv2.imencode(kind, image, options)[1]).decode()
