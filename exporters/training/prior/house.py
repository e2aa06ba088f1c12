"""Floor plan of a furnished house for the training of the prior.

It has the obstacles for the robot, the obstacles for its view, and the objects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from edge import names

CELL_M = 0.1
"""Side of a cell of the plan."""
_MARGIN_M = 0.5  # around the rooms
_CAMERA_M = 0.85
"""Higher objects hide what is behind them."""
_FLOOR_M = 0.1
"""Lower objects count as floor."""
_DETAIL = 25.0
"""Detection range of an object, as a multiple of its size."""
_FARTHEST_M = 6.0
"""Largest detection range."""


@dataclass(frozen=True, slots=True, eq=False)
class HousePlan:
    """A house on a grid of `CELL_M`; row = y, column = x.

    Attributes:
        origin_xy_m: (2,) float64, the lower-left corner of cell (0, 0) in the house's frame.
        wall: (h, w) bool, walls, and furniture that is high enough to hide what is behind it.
        closed: (h, w) bool, cells where the robot cannot stand.
        room: (h, w) int16, index of the room, -1 outside.
        doors: pairs of rooms (smaller index first) whose floors touch without a wall.
        word: (n,) int32, name of each visible object, as an index into `words`.
        xy_m: (n, 2) float64, centre of each object, in the house's frame.
        half_m: (n,) float64, half the smaller side of each object, seen from above.
        range_m: (n,) float64, detection range of each object.
        object_room: (n,) int16, room of each object.
        words: canonical names of objects.
    """

    origin_xy_m: np.ndarray
    wall: np.ndarray
    closed: np.ndarray
    room: np.ndarray
    kinds: tuple[str, ...]
    doors: frozenset[tuple[int, int]]
    word: np.ndarray
    xy_m: np.ndarray
    half_m: np.ndarray
    range_m: np.ndarray
    object_room: np.ndarray
    words: tuple[str, ...]


def read_plan(house: dict[str, Any]) -> HousePlan:
    """Return the plan of one parsed line of a file of houses.

    Args:
        house: dict with `rooms` (`category`, `polygon`: corners x, y), `walls` (x0, y0, x1, y1, z0,
            z1) and `objects` (`category`, `center`, `size`, `yaw`).

    Raises:
        KeyError: a field is missing.
        TypeError: a field has the wrong type.
        ValueError: a field has the wrong length.
    """
    corners = np.concatenate([np.asarray(r["polygon"], float) for r in house["rooms"]])
    origin = corners.min(0) - _MARGIN_M
    w, h = (math.ceil(side / CELL_M) for side in corners.max(0) + _MARGIN_M - origin)
    room = np.full((h, w), -1, np.int16)
    for i, r in enumerate(house["rooms"]):
        _fill(room, r["polygon"], origin, i)
    wall = np.zeros((h, w), np.uint8)
    for x0, y0, x1, y1, z0, z1 in house["walls"]:
        if z0 < _CAMERA_M < z1:
            a, b = (_pixel(point, origin) for point in ((x0, y0), (x1, y1)))
            cv2.line(wall, a, b, 1, 1)
    doors = _doors(room, wall)
    closed = wall.copy()
    for item in house["objects"]:
        low, high = _span(item)
        if low < _CAMERA_M and high > _FLOOR_M:
            footprint = _footprint(item)
            _fill(closed, footprint, origin, 1)
            if high > _CAMERA_M:
                _fill(wall, footprint, origin, 1)
    closed[room < 0] = 1
    return HousePlan(
        origin,
        wall.astype(bool),
        closed.astype(bool),
        room,
        tuple(r["category"] for r in house["rooms"]),
        doors,
        *_objects(house["objects"], origin, room),
    )


def _objects(objects: Sequence[dict[str, Any]], origin: np.ndarray, room: np.ndarray) -> tuple:
    """Return the last fields of `HousePlan`, from `word` on; objects inside others are left out."""
    visible = [item for item in objects if not any(_inside(item, other) for other in objects)]
    name = [names.canonical(item["category"]) for item in visible]
    words = tuple(sorted(set(name)))
    xy = np.array([item["center"][:2] for item in visible], float).reshape(-1, 2)
    size = np.array([item["size"] for item in visible], float).reshape(-1, 3)
    x, y = np.floor((xy - origin) / CELL_M).astype(int).T
    h, w = room.shape
    # Side of a square as large as the largest face of the object's box.
    side = np.sqrt(np.sort(size, 1)[:, 1:].prod(1))
    return (
        np.array([words.index(n) for n in name], np.int32),
        xy,
        0.5 * size[:, :2].min(1),
        np.minimum(_FARTHEST_M, _DETAIL * side),
        room[np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)],
        words,
    )


def _inside(item: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return True if an object's centre is within another, larger one."""
    if other is item or np.prod(other["size"]) <= np.prod(item["size"]):
        return False
    dx, dy, dz = np.subtract(item["center"], other["center"])
    c, s = math.cos(other["yaw"]), math.sin(other["yaw"])
    at = (c * dx + s * dy, c * dy - s * dx, dz)
    return all(abs(a) < 0.5 * side for a, side in zip(at, other["size"], strict=True))


def _span(item: dict[str, Any]) -> tuple[float, float]:
    """Return the heights of an object's underside and top."""
    z, high = item["center"][2], item["size"][2]
    return z - 0.5 * high, z + 0.5 * high


def _footprint(item: dict[str, Any]) -> np.ndarray:
    """Return the corners of an object's box seen from above, (4, 2)."""
    c, s = math.cos(item["yaw"]), math.sin(item["yaw"])
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * np.divide(item["size"][:2], 2)
    return corners @ np.array([(c, s), (-s, c)]) + item["center"][:2]


def _doors(room: np.ndarray, wall: np.ndarray) -> frozenset[tuple[int, int]]:
    """Return the pairs of rooms whose floors touch without a wall."""
    open_room = np.where(wall == 0, room, -1)
    pairs = set()
    for a, b in ((open_room[1:], open_room[:-1]), (open_room[:, 1:], open_room[:, :-1])):
        both = (a >= 0) & (b >= 0) & (a != b)
        pairs |= {
            tuple(sorted(pair)) for pair in zip(a[both].tolist(), b[both].tolist(), strict=True)
        }
    return frozenset(pairs)


def _pixel(point: Sequence[float], origin: np.ndarray) -> tuple[int, int]:
    """Return column and row of the cell with a point."""
    x, y = np.floor((np.asarray(point) - origin) / CELL_M).astype(int).tolist()
    return x, y


def _fill(grid: np.ndarray, polygon: Sequence[Sequence[float]], origin: np.ndarray, v: int) -> None:
    """Write a value into the cells whose centre is in a polygon."""
    shift = 10  # OpenCV's fixed-point coordinates have 10 bits after the point
    # OpenCV's integer coordinates are cell centres, hence - 0.5.
    points = ((np.asarray(polygon) - origin) / CELL_M - 0.5) * (1 << shift)
    cv2.fillPoly(grid, [np.rint(points).astype(np.int32)], v, shift=shift)
