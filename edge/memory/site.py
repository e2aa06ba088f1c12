"""The site: places, zones and room names that people have given, as GeoJSON in metres of `map`.

A `FeatureCollection` (RFC 7946) whose coordinates are x and y in `map`, not longitude and latitude:

- a place is a `Point` with `{"kind": "place", "name": "dock", "heading_deg": 90}`;
- a zone is a `Polygon` with `{"kind": "keep_out" | "stay_inside", "name": "stairs"}`;
- a room's name is a `Point` in it with `{"kind": "room", "name": "office"}`.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import cv2
import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
)

from edge import names
from edge.errors import UserError
from edge.geometry import FARTHEST_M, SE2
from edge.host.files import read_regular, write_atomically
from edge.host.worker import Worker
from edge.text import bounded_repr, one_line

log = logging.getLogger(__name__)

MAX_FEATURES = 500
"""Largest number of places, zones and room names of a site."""
MAX_CORNERS = 500
"""Largest number of corners of a zone."""
MAX_FILE_BYTES = 16 << 20
"""Largest size of a file."""
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
    return names.normalise(name_of(name)) == names.normalise(name_of(other))


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
        """Return a place whose heading is a whole hundredth of a degree, as a file keeps it."""
        yaw_rad = math.radians(round(math.degrees(pose.yaw_rad), 2))
        return cls(name, SE2(pose.x_m, pose.y_m, yaw_rad))

    def feature(self) -> dict[str, Any]:
        """Return the place as a GeoJSON feature."""
        heading = {"heading_deg": round(math.degrees(self.pose.yaw_rad), 2)}
        return _feature(self.name, "place", "Point", [self.pose.x_m, self.pose.y_m], heading)


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
        return _feature(self.name, self.kind, "Polygon", [ring])


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
        return _feature(self.name, "room", "Point", list(self.xy_m))


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
            SiteError: the site has `MAX_FEATURES` items already.
        """
        kept = tuple(other for other in self.items if not is_same(other.name, item.name))
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


def memory_geojson(
    site: Mapping[str, Any],
    objects: Iterable[Mapping[str, Any]],
    rooms: Iterable[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return all that is remembered as one GeoJSON `FeatureCollection`.

    Args:
        site: `Site.geojson`.
        objects: `KnownObject.to_json` of each object. Fields other than name and place become
            properties.
        rooms: `MappedRoom.to_json` of each room. Rooms without an outline are left out.
    """
    features = [
        _feature(obj["name"], "object", "Point", list(obj["xyz"]), _all_but(obj, "name", "xyz"))
        for obj in objects
    ]
    for room in rooms:
        if ring := room["polygon"]:
            properties = _all_but(room, "name", "polygon")
            features.append(
                _feature(room["name"], "room", "Polygon", [[*ring, ring[0]]], properties)
            )
    return {**site, "features": [*site["features"], *features]}


def _all_but(fields: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}


def _feature(
    name: str, kind: str, shape: str, coordinates: list, properties: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"kind": kind, "name": name, **(properties or {})},
        "geometry": {"type": shape, "coordinates": coordinates},
    }


# -- reading GeoJSON, which is untrusted ----------------------------------------------------------


def _check_name(text: str) -> str:
    name = name_of(text)
    if not name or any(not (c.isalnum() or c in " -_'.") for c in name):
        raise ValueError("expected letters, digits, spaces and - _ ' .")
    return name


Name = Annotated[str, Field(max_length=MAX_NAME_CHARS), AfterValidator(_check_name)]
Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M, allow_inf_nan=False)]
Position = Annotated[list[Metres], Field(min_length=2, max_length=3)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class _Point(_Model):
    type: Literal["Point"]
    coordinates: Position


class _Polygon(_Model):
    type: Literal["Polygon"]
    coordinates: Annotated[
        list[Annotated[list[Position], Field(min_length=3, max_length=MAX_CORNERS + 1)]],
        Field(min_length=1, max_length=1),
    ]


class _PlaceProperties(_Model):
    kind: Literal["place"] = "place"
    name: Name
    heading_deg: Annotated[float, Field(allow_inf_nan=False, ge=-3600, le=3600)] = 0.0


class _RoomProperties(_Model):
    kind: Literal["room"]
    name: Name


class _ZoneProperties(_Model):
    kind: Literal["keep_out", "stay_inside"]
    name: Name


class _PlaceFeature(_Model):
    type: Literal["Feature"]
    properties: _PlaceProperties
    geometry: _Point

    def item(self) -> Item:
        heading_rad = math.radians(self.properties.heading_deg)
        return Place(self.properties.name, SE2(*self.geometry.coordinates[:2], heading_rad))


class _RoomFeature(_Model):
    type: Literal["Feature"]
    properties: _RoomProperties
    geometry: _Point

    def item(self) -> Item:
        x_m, y_m = self.geometry.coordinates[:2]
        return RoomName(self.properties.name, (x_m, y_m))


class _ZoneFeature(_Model):
    type: Literal["Feature"]
    properties: _ZoneProperties
    geometry: _Polygon

    def item(self) -> Item:
        ring = [(corner[0], corner[1]) for corner in self.geometry.coordinates[0]]
        if ring[0] == ring[-1]:
            del ring[-1]
        if len(set(ring)) < 3:
            raise SiteError(f"zone {self.properties.name}: give at least three different corners")
        return Zone(self.properties.name, self.properties.kind, tuple(ring))


def _kind(value: Any) -> str:
    """Return the tag of a feature's class in the union; a feature without a kind is a place."""
    properties = value.get("properties") if isinstance(value, dict) else None
    kind = properties.get("kind") if isinstance(properties, dict) else None
    return "zone" if kind in ZONE_KINDS else "room" if kind == "room" else "place"


_Feature = Annotated[
    Union[
        Annotated[_PlaceFeature, Tag("place")],
        Annotated[_RoomFeature, Tag("room")],
        Annotated[_ZoneFeature, Tag("zone")],
    ],
    Discriminator(_kind),
]


class _Collection(_Model):
    type: Literal["FeatureCollection"]
    features: Annotated[list[_Feature], Field(max_length=MAX_FEATURES)]


_FEATURE: TypeAdapter = TypeAdapter(_Feature)


def item_of(feature: object) -> Item:
    """Return the place, zone or room name of a GeoJSON feature.

    Raises:
        SiteError: the feature is none of these.
    """
    try:
        return _FEATURE.validate_python(feature).item()
    except ValidationError as error:
        raise SiteError(f"feature: {_first_error(error)}") from None


def site_of(geojson: object, where: str = "site") -> Site:
    """Return the site of a GeoJSON `FeatureCollection`.

    Raises:
        SiteError: it is no such collection, or two items have one name; `where` begins the message.
    """
    try:
        collection = _Collection.model_validate(geojson)
    except ValidationError as error:
        raise SiteError(f"{where}: {_first_error(error)}") from None
    items = tuple(feature.item() for feature in collection.features)
    seen: set[str] = set()
    for item in items:
        if item.name in seen:
            raise SiteError(f"{where}: two features have the name {bounded_repr(item.name)}")
        seen.add(item.name)
    return Site(items)


def without_mapped(geojson: object) -> object:
    """Return a `FeatureCollection` without the objects and outlines of rooms that `edge` mapped.

    A file of `memory_geojson` can then be imported: the robot maps objects and rooms itself.
    """
    features = geojson.get("features") if isinstance(geojson, dict) else None
    if not isinstance(features, list):
        return geojson
    return {**geojson, "features": [feature for feature in features if not _is_mapped(feature)]}


def _is_mapped(feature: object) -> bool:
    try:
        kind, shape = feature["properties"]["kind"], feature["geometry"]["type"]  # type: ignore[index]
    except (KeyError, TypeError):
        return False
    return kind == "object" or (kind, shape) == ("room", "Polygon")


def read_site(path: Path, imported: bool = False) -> Site:
    """Return the site of a GeoJSON file; an empty one if there is no file.

    Args:
        path: path of the file.
        imported: True to leave out what a robot mapped; see `without_mapped`.

    Raises:
        SiteError: the file cannot be read, or is not the GeoJSON of a site.
    """
    try:
        content = read_regular(path, MAX_FILE_BYTES)
    except FileNotFoundError:
        return Site()
    except OSError as error:
        raise SiteError(f"{one_line(path)}: cannot be read: {error.strerror}") from None
    try:
        data = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise SiteError(f"{one_line(path)}: not JSON: {one_line(error)}") from None
    return site_of(without_mapped(data) if imported else data, one_line(path))


def write_site(path: Path, site: Site) -> None:
    """Write a site as GeoJSON: the whole file or nothing.

    Raises:
        OSError: the file cannot be written.
    """
    write_atomically(path, (json.dumps(site.geojson(), indent=1) + "\n").encode())


def _first_error(error: ValidationError) -> str:
    """Return the first error in words, with its place in the data."""
    first = error.errors(include_url=False)[0]
    path = ".".join(str(part) for part in first["loc"] if part not in ("place", "zone", "room"))
    text = first["msg"].removeprefix("Value error, ")
    return one_line(f"{path}: {text}" if path else text)


@dataclass(eq=False)
class SiteFile:
    """The site of a running service, saved in the background after each change.

    Args:
        path: path of the GeoJSON file; None keeps the site for this run only.
        on_error: called with one line when saving fails, on the thread that saves.
        site: the site at the start; None reads the file.

    Attributes:
        start: the first pose of this run; None before there was one.

    Raises:
        SiteError: the file exists and cannot be used.
    """

    path: Path | None = None
    on_error: Callable[[str], None] = log.warning
    site: Site = None  # type: ignore[assignment]
    start: Place | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        if self.site is None:
            self.site = Site() if self.path is None else read_site(self.path)
        # The last result of `known`, after the site and the start for which it holds.
        self._known: tuple[Site, Place | None, Site] = self.site, None, self.site
        self._worker: Worker[Site, None] = Worker("site", self._save, finish_on_close=True)

    @property
    def known(self) -> Site:
        """The site with `start` among its places; the same object until one of them changes."""
        site, start, known = self._known
        if site is not self.site or start is not self.start:
            site, start = self.site, self.start
            if start is None or site.place(START) is not None:
                known = site
            else:
                known = Site((*site.items, start))
            self._known = site, start, known
        return known

    def change(self, site: Site) -> None:
        """Replace the site."""
        self.site = site
        if self.path is not None:
            self._worker.submit(site)

    def close(self, timeout_s: float = 2.0) -> None:
        """Finish saving."""
        self._worker.close(timeout_s=timeout_s)

    def _save(self, site: Site) -> None:
        assert self.path is not None
        try:
            write_site(self.path, site)
        except OSError as error:
            self.on_error(f"{one_line(self.path)}: not saved: {error.strerror}")
