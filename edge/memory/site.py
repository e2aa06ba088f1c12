"""The site: places, zones and room names that people have given, as GeoJSON in metres of `map`.

A `FeatureCollection` (RFC 7946) whose coordinates are x and y in `map`, not longitude and latitude:

- a place is a `Point` with `{"kind": "place", "name": "dock", "heading_deg": 90}`;
- a zone is a `Polygon` with `{"kind": "keep_out" | "stay_inside", "name": "stairs"}`;
- a room's name is a `Point` in it with `{"kind": "room", "name": "office"}`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Union

import cv2
import numpy as np

from edge import names
from edge.errors import UserError
from edge.geometry import SE2
from edge.text import bounded_repr, one_line

MAX_FEATURES = 500
"""Largest number of places, zones and room names of a site."""
MAX_NAME_CHARS = 60
"""Largest number of characters of a name."""
START = "start"
"""A place that is always known: the first pose of this run."""
_ARTICLES = ("the", "a", "an", "my", "our", "your")
ZONE_KINDS = ("keep_out", "stay_inside")
"""Kinds of zones; see `Zone`."""

Point = tuple[float, float]  # x and y in `map` [m]


class SiteError(UserError):
    """A place, zone or file that cannot be used. The message is one line."""


def name_of(text: str) -> str:
    """Return a name as it is stored: lower case, single spaces, no article.

    >>> name_of("The  Charging Dock")
    'charging dock'
    """
    words = text.lower().split()
    return " ".join(words[1:] if len(words) > 1 and words[0] in _ARTICLES else words)


def is_same(name: str, other: str) -> bool:
    """Return True if two names mean the same, however their numbers are written.

    >>> is_same("Room 12", "the room twelve")
    True
    """
    return _key(name) == _key(other)


@lru_cache(4096)  # a tick compares each room with each object
def _key(name: str) -> str:
    return names.normalise(name_of(name))


def feature_of(
    name: str, kind: str, shape: str, coordinates: list, properties: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return a GeoJSON feature; `shape` is `Point` or `Polygon`."""
    return {
        "type": "Feature",
        "properties": {"kind": kind, "name": name, **(properties or {})},
        "geometry": {"type": shape, "coordinates": coordinates},
    }


@dataclass(frozen=True, slots=True)
class Place:
    """A pose with a name.

    Attributes:
        name: see `name_of`.
        pose: pose in `map`.
    """

    name: str
    pose: SE2

    @classmethod
    def at(cls, name: str, pose: SE2) -> Place:
        """Return a place whose heading is a multiple of 0.01 degrees, as a file keeps it."""
        yaw_rad = math.radians(round(math.degrees(pose.yaw_rad), 2))
        return cls(name, SE2(pose.x_m, pose.y_m, yaw_rad))

    def feature(self) -> dict[str, Any]:
        """Return the place as a GeoJSON feature."""
        heading = {"heading_deg": round(math.degrees(self.pose.yaw_rad), 2)}
        return feature_of(self.name, "place", "Point", [self.pose.x_m, self.pose.y_m], heading)


@dataclass(frozen=True, slots=True)
class Zone:
    """A polygon that the robot must keep out of, or stay inside of.

    Attributes:
        kind: `keep_out` or `stay_inside`.
        corners_m: corners (x, y) in `map`, in order, at least three; the first is not repeated.
    """

    name: str
    kind: Literal["keep_out", "stay_inside"]
    corners_m: tuple[Point, ...]

    def feature(self) -> dict[str, Any]:
        """Return the zone as a GeoJSON feature."""
        ring = [list(corner) for corner in (*self.corners_m, self.corners_m[0])]
        return feature_of(self.name, self.kind, "Polygon", [ring])


@dataclass(frozen=True, slots=True)
class RoomName:
    """A person's name for the room around a point.

    Attributes:
        name: see `name_of`.
        xy_m: the point in `map`.
    """

    name: str
    xy_m: Point

    def feature(self) -> dict[str, Any]:
        """Return the name as a GeoJSON feature."""
        return feature_of(self.name, "room", "Point", list(self.xy_m))


Item = Union[Place, Zone, RoomName]


@dataclass(frozen=True, slots=True)
class Site:
    """All places, zones and room names; immutable.

    Attributes:
        items: all of them, each with its own name.

    Example:
        >>> site = Site().with_item(Place("dock", SE2(1.0, 2.0, 0.0)))
        >>> site.place("the dock").pose.x_m
        1.0
        >>> site.without("dock").items
        ()
    """

    items: tuple[Item, ...] = ()

    @property
    def places(self) -> tuple[Place, ...]:
        """The named places."""
        return tuple(item for item in self.items if isinstance(item, Place))

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The zones."""
        return tuple(item for item in self.items if isinstance(item, Zone))

    @property
    def room_names(self) -> tuple[RoomName, ...]:
        """The names that people gave to rooms."""
        return tuple(item for item in self.items if isinstance(item, RoomName))

    def place(self, name: str) -> Place | None:
        """Return the place of this name, or None."""
        return next((place for place in self.places if is_same(place.name, name)), None)

    def room_name(self, name: str) -> RoomName | None:
        """Return the room name that means the same as `name`, or None."""
        return next((room for room in self.room_names if is_same(room.name, name)), None)

    def polygons_m(self, kind: str) -> list[np.ndarray]:
        """Return the corners of all zones of a kind, each (n, 2) float64."""
        return [np.array(zone.corners_m) for zone in self.zones if zone.kind == kind]

    def closed_by(self, x_m: float, y_m: float) -> str:
        """Return the name of a zone that closes a point in `map`; "" if none does."""

        def covers(zone: Zone) -> bool:
            ring = np.array(zone.corners_m, np.float32)
            return cv2.pointPolygonTest(ring, (x_m, y_m), measureDist=False) >= 0

        for zone in self.zones:
            if zone.kind == "keep_out" and covers(zone):
                return zone.name
        stay = [zone for zone in self.zones if zone.kind == "stay_inside"]
        return "" if not stay or any(map(covers, stay)) else stay[0].name

    def with_item(self, item: Item) -> Site:
        """Return the site with an item added. The new item replaces an item of the same name.

        Raises:
            SiteError: the site has `MAX_FEATURES` items already, or a zone and a place or room
                would have one name.
        """
        kept = tuple(other for other in self.items if not is_same(other.name, item.name))
        replaced = [other for other in self.items if is_same(other.name, item.name)]
        if any(isinstance(other, Zone) != isinstance(item, Zone) for other in replaced):
            kind = "a zone" if isinstance(replaced[0], Zone) else "a place or room"
            raise SiteError(
                f"site: {bounded_repr(item.name)} is the name of {kind} already; use another name, "
                "or remove that first"
            )
        if len(kept) >= MAX_FEATURES:
            raise SiteError(
                f"site: at most {MAX_FEATURES} places and zones are allowed; remove one first"
            )
        return Site((*kept, item))

    def without(self, name: str) -> Site:
        """Return the site without the item of this name.

        Raises:
            SiteError: no item has this name.
        """
        kept = tuple(item for item in self.items if not is_same(item.name, name))
        if len(kept) == len(self.items):
            known = one_line(", ".join(item.name for item in self.items) or "none")
            raise SiteError(f"site: no place or zone {bounded_repr(name)} (known: {known})")
        return Site(kept)

    def geojson(self) -> dict[str, Any]:
        """Return the site as a GeoJSON `FeatureCollection`."""
        return {"type": "FeatureCollection", "features": [item.feature() for item in self.items]}
