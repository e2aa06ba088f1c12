"""Rooms as shapes: regions of the map with ids that last, outlines, doors and standing points.

A cut is a `RegionMap`: the map divided into regions. A survey gives ids and shapes to the regions
that are rooms. This module only knows arrays; another thread computes a survey from the map and the
last survey.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from edge.mapping.regions import NO_REGIONS, UNKNOWN, RegionMap

LEAST_ROOM_M2 = 1.5
"""A smaller region is no room: a gap between furniture, or a glimpse through a door."""
INSIDE_M = 0.5
"""The robot counts as inside a room from this distance to the border on."""
_STAND_M = 0.6  # distance of standing points from the border; more than `INSIDE_M`
# In a narrow room, this share of its largest depth takes the place of `INSIDE_M` and `_STAND_M`.
_NARROW = 0.8
_MAX_POINTS = 64  # largest number of standing points
_OUTLINE_M = 0.15  # largest error of a simplified outline
_MIN_OVERLAP = 0.3  # smallest overlap, as a share of the smaller room, to be the same room
_MAX_LOST = 64  # largest number of rooms without a region that are remembered


class Passage(NamedTuple):
    """A passage to another room.

    Attributes:
        xy_m: middle of the passage in `map`.
    """

    room: int
    xy_m: tuple[float, float]
    width_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RoomShape:
    """The shape of one room.

    Attributes:
        id: number of the room; it stays while the map grows.
        region: its region in `RoomSurvey.regions`.
        polygon_m: (k, 2) float64 [m], simplified outline in `map`, k >= 3.
        area_m2: known floor, with furniture.
        xy_m: the point farthest from the border.
        inside_m: the robot counts as inside from this distance to the border on: `INSIDE_M`, or
            less in a narrow room.
        points_m: (j, 2) float32, points to stand at, at most `_MAX_POINTS`.
    """

    id: int
    region: int
    polygon_m: np.ndarray
    area_m2: float
    xy_m: tuple[float, float]
    inside_m: float
    points_m: np.ndarray
    doors: tuple[Passage, ...]


class LostRoom(NamedTuple):
    """A room that has no region now: it was merged with another, or is not mapped again yet.

    Attributes:
        x_m: x of a point of the room in `map`.
    """

    id: int
    x_m: float
    y_m: float


class RoomSurvey(NamedTuple):
    """All rooms of the map at one time.

    Attributes:
        ids: (n + 1,) int64, room of each region; 0 for none.
        lost: rooms without a region, newest last. A new region that contains a lost room's point
            gets its id.
        depth_m: (h, w) float32, distance of each cell to the border of its room; 0 outside.
    """

    regions: RegionMap
    ids: np.ndarray
    next_id: int
    lost: tuple[LostRoom, ...]
    shapes: tuple[RoomShape, ...]
    depth_m: np.ndarray

    def depth_at(self, x_m: float, y_m: float) -> tuple[int, float]:
        """Return the room at a point, 0 for none, and the distance to its border."""
        cell = self.regions.grid.cell_of(x_m, y_m)
        if cell is None:
            return 0, 0.0
        return int(self.ids[self.regions.label[cell]]), float(self.depth_m[cell])


# The survey of an empty map.
NO_SURVEY = RoomSurvey(NO_REGIONS, np.zeros(1, np.int64), 1, (), (), np.zeros((0, 0), np.float32))


def survey_rooms(regions: RegionMap, before: RoomSurvey) -> RoomSurvey:
    """Return the rooms of a new cut. Rooms of the last survey keep their ids.

    Of two rooms that are now one, the one with the larger overlap remains, and the other is lost.
    Of two parts of a room, the larger keeps its id.
    """
    ids = np.zeros(regions.n + 1, np.int64)
    _keep_overlapping(regions, before, ids)
    lost = [room for room in before.lost if room.id not in ids]
    next_id = before.next_id
    cells = np.bincount(regions.label.ravel(), minlength=regions.n + 1)
    large = cells * regions.grid.resolution_m**2 >= LEAST_ROOM_M2
    large[0] = False
    for region in np.flatnonzero(large & (ids == 0)).tolist():
        # The room that was lost last, of those with their point in this region.
        lost_room = next(
            (room for room in reversed(lost) if _contains(regions, region, room)), None
        )
        if lost_room is not None:
            lost.remove(lost_room)
            ids[region] = lost_room.id
        else:
            ids[region] = next_id
            next_id += 1
    lost += [LostRoom(shape.id, *shape.xy_m) for shape in before.shapes if shape.id not in ids]
    return outline_rooms(regions, ids, next_id, tuple(lost[-_MAX_LOST:]))


def _keep_overlapping(regions: RegionMap, before: RoomSurvey, ids: np.ndarray) -> None:
    """Write the ids of the last survey to the regions that overlap its rooms most."""
    old, new = _common_cells(before.regions, regions)
    both = (old > 0) & (new > 0)
    if not both.any():
        return
    pairs, count = np.unique(np.stack((old[both], new[both]), axis=1), axis=0, return_counts=True)
    old_cells = np.bincount(before.regions.label.ravel(), minlength=before.regions.n + 1)
    new_cells = np.bincount(regions.label.ravel(), minlength=regions.n + 1)
    taken: set[int] = set()
    for pair in np.argsort(-count, kind="stable").tolist():
        a, b = (int(v) for v in pairs[pair])
        room = int(before.ids[a])
        enough = count[pair] >= _MIN_OVERLAP * min(old_cells[a], new_cells[b])
        if room and enough and ids[b] == 0 and room not in taken:
            ids[b] = room
            taken.add(room)


def _common_cells(a: RegionMap, b: RegionMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels of two cuts on the cells that both have; empty if there are none."""
    cell_m = b.grid.resolution_m
    if a.grid.resolution_m != cell_m:
        return np.zeros((0, 0), np.int16), np.zeros((0, 0), np.int16)
    # Lower corner of each cut, in cells.
    at = [np.round(np.array(cut.grid.origin_xy_m) / cell_m).astype(int) for cut in (a, b)]
    size = [np.array(cut.label.shape)[::-1] for cut in (a, b)]
    low, high = np.maximum(*at), np.minimum(at[0] + size[0], at[1] + size[1])
    if (high <= low).any():
        return np.zeros((0, 0), np.int16), np.zeros((0, 0), np.int16)
    labels = []
    for cut, corner in zip((a, b), at, strict=True):
        (x0, y0), (x1, y1) = low - corner, high - corner
        labels.append(cut.label[y0:y1, x0:x1])
    return labels[0], labels[1]


def _contains(regions: RegionMap, region: int, room: LostRoom) -> bool:
    cell = regions.grid.cell_of(room.x_m, room.y_m)
    return cell is not None and int(regions.label[cell]) == region


def outline_rooms(
    regions: RegionMap, ids: np.ndarray, next_id: int, lost: tuple[LostRoom, ...]
) -> RoomSurvey:
    """Return the survey of a cut, with outlines, doors and standing points.

    A region that is only a line loses its id.

    Args:
        regions: the cut.
        ids: see `RoomSurvey`; changed in place.
        next_id: see `RoomSurvey`.
        lost: see `RoomSurvey`.
    """
    depth_m = np.zeros(regions.label.shape, np.float32)
    shapes = []
    for region in np.flatnonzero(ids).tolist():
        shape = _room_shape(regions, ids, region, depth_m)
        if shape is not None:
            shapes.append(shape)
        else:
            ids[region] = 0
    shapes.sort(key=lambda shape: shape.id)
    return RoomSurvey(regions, ids, next_id, lost, tuple(shapes), depth_m)


def _room_shape(
    regions: RegionMap, ids: np.ndarray, region: int, depth_m: np.ndarray
) -> RoomShape | None:
    """Return the shape of a region, and write its depths; None if it is only a line."""
    grid, label = regions.grid, regions.label
    rows, columns = np.nonzero(label == region)
    y0, y1, x0, x1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    inside = label[y0:y1, x0:x1] == region
    contours, _ = cv2.findContours(
        inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    contour = max(contours, key=cv2.contourArea)
    outline = cv2.approxPolyDP(contour, _OUTLINE_M / grid.resolution_m, True)
    if len(outline) < 3:
        return None
    # What was not seen in the middle of a room, such as the floor behind a table, is no border.
    filled = np.zeros(inside.shape, np.uint8)
    cv2.drawContours(filled, [contour], -1, 1, cv2.FILLED)
    unseen = grid.cells[y0:y1, x0:x1] == UNKNOWN
    filled_in = inside | (unseen & (filled > 0))
    # Distance to the nearest cell outside, also outside of the cut; half a cell less to its edge.
    border_cells = cv2.distanceTransform(np.pad(filled_in, 1).astype(np.uint8), cv2.DIST_L2, 5)[
        1:-1, 1:-1
    ]
    deep_m = np.maximum(border_cells - 0.5, 0.0) * np.float32(grid.resolution_m)
    deep_m[~inside] = 0.0
    depth_m[y0:y1, x0:x1][inside] = deep_m[inside]
    deepest_m = float(deep_m.max())
    stand_m = _STAND_M if deepest_m >= _STAND_M else _NARROW * deepest_m
    r, c = np.nonzero(deep_m >= stand_m)
    chosen = np.unique(np.linspace(0, len(r) - 1, _MAX_POINTS).astype(int))
    middle = np.unravel_index(int(deep_m.argmax()), deep_m.shape)
    x_m, y_m = grid.centres_m(np.array(y0 + middle[0]), np.array(x0 + middle[1])).tolist()
    return RoomShape(
        int(ids[region]),
        region,
        grid.to_metres(outline[:, 0, :] + (x0, y0) + 0.5),
        len(rows) * grid.resolution_m**2,
        (x_m, y_m),
        min(INSIDE_M, _NARROW * deepest_m),
        grid.centres_m(y0 + r[chosen], x0 + c[chosen]).astype(np.float32),
        _doors(regions, ids, region),
    )


def _doors(regions: RegionMap, ids: np.ndarray, region: int) -> tuple[Passage, ...]:
    """Return the passages from a region to other rooms."""
    grid, label = regions.grid, regions.label
    doors = []
    for other in np.flatnonzero(regions.border[region]).tolist():
        if ids[other] == 0:
            continue
        points = []  # middles of the cell edges between both regions, as (row, column)
        for a, b, step in (
            (label[1:], label[:-1], (0.5, 0.0)),
            (label[:, 1:], label[:, :-1], (0.0, 0.5)),
        ):
            between = ((a == region) & (b == other)) | ((a == other) & (b == region))
            points.append(np.argwhere(between) + step)
        cells = np.concatenate(points)
        middle = cells[np.square(cells - cells.mean(axis=0)).sum(axis=1).argmin()]
        x_m, y_m = grid.centres_m(middle[0], middle[1]).tolist()
        width_m = float(regions.border[region, other]) * grid.resolution_m
        doors.append(Passage(int(ids[other]), (x_m, y_m), width_m))
    return tuple(doors)
