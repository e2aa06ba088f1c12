"""Files of a site and of the entire memory, as GeoJSON (`edge.memory.site` has the format).

What is read is untrusted.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)

from edge.geometry import FARTHEST_M, SE2
from edge.host.files import read_regular, write_atomically
from edge.host.worker import Worker
from edge.memory.site import (
    MAX_FEATURES,
    MAX_NAME_CHARS,
    START,
    Item,
    Place,
    RoomName,
    Site,
    SiteError,
    Zone,
    feature_of,
    name_of,
)
from edge.text import bounded_repr, one_line

log = logging.getLogger(__name__)

MAX_CORNERS = 500
"""Largest number of corners of a zone."""
MAX_FILE_BYTES = 16 << 20
"""Largest size of a file."""


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
        feature_of(obj["name"], "object", "Point", list(obj["xyz"]), _all_but(obj, "name", "xyz"))
        for obj in objects
    ]
    for room in rooms:
        if ring := room["polygon"]:
            properties = _all_but(room, "name", "polygon")
            features.append(
                feature_of(room["name"], "room", "Polygon", [[*ring, ring[0]]], properties)
            )
    return {**site, "features": [*site["features"], *features]}


def _all_but(fields: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}


# -- reading --------------------------------------------------------------------------------------


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


def _of_place(heading_deg: Any, properties: ValidationInfo) -> Any:
    """Return the heading of a place; 0.0 for other kinds, which have none."""
    return heading_deg if properties.data.get("kind") == "place" else 0.0


class _Properties(_Model):
    kind: Literal["place", "room", "keep_out", "stay_inside"] = "place"
    name: Name
    heading_deg: Annotated[
        float, Field(allow_inf_nan=False, ge=-3600, le=3600), BeforeValidator(_of_place)
    ] = 0.0


class _Feature(_Model):
    type: Literal["Feature"]
    properties: _Properties
    geometry: Annotated[Union[_Point, _Polygon], Discriminator("type")]

    def item(self) -> Item:
        """Return the item; raise ValueError if the geometry does not fit it."""
        name, kind = self.properties.name, self.properties.kind
        match self.geometry, kind:
            case _Polygon(coordinates=[ring]), "keep_out" | "stay_inside":
                corners = [(corner[0], corner[1]) for corner in ring]
                if corners[0] == corners[-1]:
                    del corners[-1]
                if len(set(corners)) < 3:
                    raise ValueError(f"zone {name}: give at least three different corners")
                return Zone(name, kind, tuple(corners))
            case _Point(coordinates=[x_m, y_m, *_]), "room":
                return RoomName(name, (x_m, y_m))
            case _Point(coordinates=[x_m, y_m, *_]), "place":
                return Place(name, SE2(x_m, y_m, math.radians(self.properties.heading_deg)))
        shape = self.geometry.type
        needed = "Polygon" if shape == "Point" else "Point"
        raise ValueError(f"{kind} {name}: needs a {needed}, has a {shape}")


# Raised while pydantic validates, the errors of `item` get the number of the feature.
_Item = Annotated[_Feature, AfterValidator(_Feature.item)]
_ITEM: TypeAdapter = TypeAdapter(_Item)


class _Collection(_Model):
    type: Literal["FeatureCollection"]
    features: Annotated[list[_Item], Field(max_length=MAX_FEATURES)]


def item_of(feature: object) -> Item:
    """Return the place, zone or room name of a GeoJSON feature.

    Raises:
        SiteError: the feature is none of these.
    """
    try:
        return _ITEM.validate_python(feature)
    except ValidationError as error:
        raise SiteError(f"feature: {_first_error(error)}") from None


def site_of(geojson: object, where: str = "site") -> Site:
    """Return the site of a GeoJSON `FeatureCollection`.

    Raises:
        SiteError: it is no such collection, or two items have one name; `where` begins the message.
    """
    try:
        items: tuple[Any, ...] = tuple(_Collection.model_validate(geojson).features)
    except ValidationError as error:
        raise SiteError(f"{where}: {_first_error(error)}") from None
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
    """Write a site as GeoJSON: the entire file or nothing.

    Raises:
        OSError: the file cannot be written.
    """
    write_atomically(path, (json.dumps(site.geojson(), indent=1) + "\n").encode())


def _first_error(error: ValidationError) -> str:
    """Return the first error in words, with its place in the data."""
    first = error.errors(include_url=False)[0]
    place, text = first["loc"], first["msg"].removeprefix("Value error, ")
    if first["type"].startswith("union_tag"):  # the type of a geometry
        got = bounded_repr(first["ctx"]["tag"]) if "tag" in first["ctx"] else "none"
        place, text = (*place, "type"), f"must be Point or Polygon, got {got}"
    path = ".".join(str(part) for part in place if part not in ("Point", "Polygon"))
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
