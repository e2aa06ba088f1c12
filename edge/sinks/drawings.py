"""Map drawings for people: driven path, objects, goal, places and zones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from edge.bus.wire import markers
from edge.bus.wire.detections import Box3D
from edge.bus.wire.markers import Marker
from edge.geometry import SE2
from edge.loop.result import TickResult
from edge.memory import Item, KnownObject, MappedRoom, Place, Site, Zone
from edge.types import Goal, Instance

# Colours: red, green, blue and opacity, each from 0 to 1.
_FRONTIER: markers.RGBA = (0.2, 0.6, 1.0, 0.8)
_OBJECT: markers.RGBA = (1.0, 0.6, 0.1, 0.6)
_REJECTED: markers.RGBA = (0.5, 0.5, 0.5, 0.3)
_GOAL: markers.RGBA = (0.2, 0.9, 0.3, 0.9)
_TEXT: markers.RGBA = (1.0, 1.0, 1.0, 1.0)
_REMEMBERED: markers.RGBA = (0.4, 0.6, 0.9, 0.6)
_ROOM: markers.RGBA = (0.6, 0.4, 0.9, 0.8)
_PLACE: markers.RGBA = (0.1, 0.7, 0.8, 0.9)
_ZONES: dict[str, markers.RGBA] = {
    "keep_out": (0.9, 0.2, 0.2, 0.9), "stay_inside": (0.2, 0.7, 0.3, 0.9),
}  # fmt: skip
_LABEL_M = (0.0, 0.0, 0.2)  # a text marker has a height only


class PathRing:
    """The driven path: the last poses, in a preallocated ring."""

    def __init__(self, capacity: int = 2000, apart_m: float = 0.1) -> None:
        self._poses = np.zeros((capacity, 3))
        self._apart_m = apart_m
        self._n = 0

    def add(self, pose: SE2) -> None:
        """Append a pose, unless it is closer than `apart_m` to the last one."""
        if self._n:
            last = self._poses[(self._n - 1) % len(self._poses)]
            if math.hypot(pose.x_m - last[0], pose.y_m - last[1]) < self._apart_m:
                return
        self._poses[self._n % len(self._poses)] = pose.x_m, pose.y_m, pose.yaw_rad
        self._n += 1

    def poses(self) -> np.ndarray:
        """Return a copy of the poses, (n, 3) x, y, yaw, oldest first."""
        first = self._n % len(self._poses)  # index of the oldest pose, if the ring is full
        if self._n <= len(self._poses):
            return self._poses[: self._n].copy()
        return np.roll(self._poses, -first, axis=0)


class Drawing(NamedTuple):
    """The drawn parts of a result.

    Attributes:
        frontiers_m: (n, 2) float32.
        instances: objects of the mission.
        site: places and zones.
        goal: current goal, if any.
    """

    frontiers_m: np.ndarray
    instances: Sequence[Instance]
    objects: Sequence[KnownObject]
    rooms: Sequence[MappedRoom]
    site: Site
    goal: Goal | None


def drawing_of(result: TickResult) -> Drawing:
    """Return the drawn parts of a result; any thread may use them."""
    return Drawing(
        result.frontiers(),
        result.instances(),
        result.objects(),
        result.rooms,
        result.site,
        result.goal,
    )


def markers_of(drawing: Drawing) -> list[Marker]:
    """Return markers: frontiers as spheres, objects as cubes with names, the goal as an arrow.

    Places are arrows with names, zones lines with names, and remembered objects spheres with names.
    Remembered objects with the name of an object of the mission are left out.
    """
    drawn = []
    if len(drawing.frontiers_m):
        points = np.zeros((len(drawing.frontiers_m), 3))
        points[:, :2] = drawing.frontiers_m
        drawn.append(
            Marker("frontiers", 0, markers.SPHERE_LIST, (0.1,) * 3, _FRONTIER, points_m=points)
        )
    for i, instance in enumerate(drawing.instances):
        x, y, z = map(float, instance.center_m)
        colour = _REJECTED if instance.state == "rejected" else _OBJECT
        at, text = SE2(x, y, 0.0), f"{instance.label} {instance.score:.2f}"
        drawn.append(Marker("things", i, markers.CUBE, (0.25,) * 3, colour, at, z))
        drawn.append(Marker("names", i, markers.TEXT, _LABEL_M, _TEXT, at, z + 0.4, text))
    named = {instance.label for instance in drawing.instances}
    others = [known for known in drawing.objects if known.name not in named]
    if others:
        points = np.array([known.xyz_m for known in others])
        drawn.append(
            Marker("objects", 0, markers.SPHERE_LIST, (0.12,) * 3, _REMEMBERED, points_m=points)
        )
    for i, known in enumerate(others):
        x, y, z = known.xyz_m
        at = SE2(x, y, 0.0)
        drawn.append(
            Marker("object names", i, markers.TEXT, _LABEL_M, _REMEMBERED, at, z + 0.3, known.name)
        )
    for room in drawing.rooms:
        drawn.append(_line("rooms", room.id, room.polygon_m, _ROOM, 0.03))
        at = SE2(*room.xy_m, 0.0)
        drawn.append(
            Marker("room names", room.id, markers.TEXT, _LABEL_M, _ROOM, at, 0.2, room.title)
        )
    for i, item in enumerate(drawing.site.items):
        drawn += _item_markers(i, item)
    if drawing.goal is not None:
        pose = drawing.goal.pose
        drawn.append(Marker("goal", 0, markers.ARROW, (0.5, 0.08, 0.08), _GOAL, pose, 0.1))
    return drawn


def boxes_of(drawing: Drawing) -> list[Box3D]:
    """Return the objects of the mission that are not rejected, and the remembered ones.

    The boxes of the mission's objects are those of their points; the size of others is not known.
    """
    boxes = []
    for found in drawing.instances:
        if found.state != "rejected":
            points = found.points_m if len(found.points_m) else found.center_m[None]
            low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
            center = tuple(0.5 * (a + b) for a, b in zip(low, high, strict=True))
            size = tuple(b - a for a, b in zip(low, high, strict=True))
            boxes.append(Box3D(found.id, found.label, float(found.score), center, size))
    named = {found.label for found in drawing.instances}
    boxes += [
        Box3D(known.id, known.name, known.confidence, known.xyz_m, (0.0, 0.0, 0.0))
        for known in drawing.objects
        if known.name not in named
    ]
    return boxes


def _line(
    group: str, id: int, corners_m: ArrayLike, colour: markers.RGBA, width_m: float
) -> Marker:
    """Return a closed line through corners (n, 2)."""
    flat = np.asarray(corners_m, np.float64).reshape(-1, 2)
    ring = np.zeros((len(flat) + 1, 3))
    if len(flat):
        ring[:-1, :2], ring[-1, :2] = flat, flat[0]
    return Marker(group, id, markers.LINE_STRIP, (width_m,) * 3, colour, points_m=ring)


def _item_markers(i: int, item: Item) -> Iterator[Marker]:
    """Yield the markers of a place or zone; its label is over its position or first corner.

    A name that a person gave to a room has no marker here: it is the title of the room's marker.
    """
    if isinstance(item, Place):
        yield Marker("places", i, markers.ARROW, (0.4, 0.06, 0.06), _PLACE, item.pose, 0.05)
        yield Marker("place names", i, markers.TEXT, _LABEL_M, _PLACE, item.pose, 0.4, item.name)
    elif isinstance(item, Zone):
        colour = _ZONES[item.kind]
        yield _line("zones", i, item.corners_m, colour, 0.05)
        at = SE2(*item.corners_m[0], 0.0)
        yield Marker("zone names", i, markers.TEXT, _LABEL_M, colour, at, 0.3, item.name)
