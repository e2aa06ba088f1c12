"""Grids and camera images, encoded for the page."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np

from edge.geometry import Grid, thin
from edge.live.sink import Shot

MAX_SIDE = 1600
JPEG_QUALITY = 75
_FAST = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def grid_of(grid: Grid) -> dict[str, Any]:
    """A grid of bytes: its place, and its cells as a grey PNG, row 0 (the lowest y) on top.

    Occupancy's -1 becomes 255.
    """
    grid = thin(grid, MAX_SIDE)
    height, width = grid.cells.shape
    return {
        "origin_xy_m": list(map(float, grid.origin_xy_m)),
        "resolution_m": grid.resolution_m,
        "size": [width, height],
        "png": _encoded(".png", grid.cells.view(np.uint8), _FAST),
    }


def shot_of(shot: Shot) -> dict[str, Any]:
    """A camera image as JPEG, with its boxes and letters."""
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
        "letters": [[letter, round(u, 4), round(v, 4)] for letter, u, v in shot.letters],
        "jpeg": _encoded(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]),
    }


def _encoded(kind: str, image: np.ndarray, options: list[int]) -> str:
    """In base64; what has no pixels is nothing."""
    if image.size == 0:
        return ""
    return base64.b64encode(cv2.imencode(kind, image, options)[1]).decode()
