"""The true rooms of a simulated world, and the places that count as in a room of a kind."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from edge.lab.sim.base import Room, World, WorldObject

INSIDE_M = 0.5
"""A robot is at a room goal if it is this far inside: from walls, and from doors to other rooms."""


def true_room_at(world: World, xy_m: np.ndarray) -> np.ndarray:
    """Return the index of the true room of each of the points (n, 2): (n,) int64, -1 for none."""
    found = np.full(len(xy_m), -1)
    for number, room in enumerate(world.rooms):  # a room is a list of rectangles
        for x0, y0, x1, y1 in room:
            x, y = xy_m[:, 0], xy_m[:, 1]
            found[(x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)] = number
    return found


def room_of(world: World, item: WorldObject) -> Room | None:
    """Return the room that an object stands in or is nearest to; None without room data."""
    x, y = item.center_m[:2]
    return min(world.rooms, key=lambda room: _away_m(room, x, y), default=None)


def distance_to_room_m(world: World, kind: str, x_m: float, y_m: float) -> float:
    """Return the distance to the nearest room of a kind: 0 inside, inf if there is none."""
    return min((_away_m(room, x_m, y_m) for room in _rooms_of(world, kind)), default=math.inf)


def inside(world: World, rooms: Sequence[Room]) -> np.ndarray:
    """Return (rows, columns) bool on the plan's raster: True inside one of the rooms."""
    grid = world.plan.grid
    found = np.zeros(grid.cells.shape, bool)
    for x0, y0, x1, y1 in (rectangle for room in rooms for rectangle in room):
        (left, bottom), (right, top) = grid.to_cells((x0, y0)), grid.to_cells((x1, y1))
        rows = slice(max(round(bottom), 0), max(round(top), 0))
        found[rows, max(round(left), 0) : max(round(right), 0)] = True
    return found


def in_room_of_kind(world: World, kind: str, robot_radius_m: float) -> np.ndarray:
    """Return (rows, columns) bool on the plan's raster: True where the robot is at a room goal.

    It fits there, and is `INSIDE_M` inside a room of the kind.
    """
    plan = world.plan
    found = np.zeros(plan.grid.cells.shape, bool)
    for room in _rooms_of(world, kind):
        floor = np.pad(inside(world, [room]).astype(np.uint8), 1)  # the plan's edge is outside
        depth = cv2.distanceTransform(floor, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
        found |= depth * plan.grid.resolution_m >= INSIDE_M
    return found & (plan.clearance_m > robot_radius_m)


def _rooms_of(world: World, kind: str) -> list[Room]:
    pairs = zip(world.rooms, world.room_kinds, strict=False)  # no kinds: unknown
    return [room for room, room_kind in pairs if room_kind == kind]


def _away_m(room: Room, x_m: float, y_m: float) -> float:
    """Return the distance of a point from a room."""
    return min(
        math.hypot(max(x0 - x_m, 0.0, x_m - x1), max(y0 - y_m, 0.0, y_m - y1))
        for x0, y0, x1, y1 in room
    )
