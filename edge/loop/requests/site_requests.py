"""Requests about the site: places, zones and room names that people gave.

`edge place`, `edge zone`, `edge room` and the live page send them, with the key `site/request`.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import TYPE_CHECKING

from edge.bus.verbs import Request, Verb, check_flag, check_text, show
from edge.errors import UserError
from edge.memory import Place, RoomName, Site, Zone, item_of, site_of, without_mapped
from edge.memory.rooms import SAME_SPOT_M
from edge.memory.site import MAX_NAME_CHARS, ZONE_KINDS, Item, name_of
from edge.text import bounded_repr, one_line

if TYPE_CHECKING:
    from edge.loop.service import Service


def _check_set(fields: dict) -> dict:
    """Return the checked fields of `set`; the three forms are in `SITE_VERBS`.

    Returns:
        `room`, `kind` and `name` of a zone to make of a room; or `item`, the place, zone or room
        name to add, with `here` if it gets the robot's position.
    """
    kind = fields.get("kind", "place")
    if kind in ZONE_KINDS and "room" in fields and "feature" not in fields:
        room = check_text("room", fields["room"], MAX_NAME_CHARS)
        name = check_text("name", fields.get("name", f"{room} zone"), MAX_NAME_CHARS)
        return {"room": room, "kind": kind, "name": _item_here(name).name}
    if "room" in fields or ("name" in fields) == ("feature" in fields):
        raise ValueError(
            "do: set needs a name (for the place or room where the robot is), a feature (GeoJSON), "
            "or a room with kind: keep_out or stay_inside; give only one of the three"
        )
    if "feature" in fields:
        return {"item": item_of(fields["feature"])}
    if kind not in ("place", "room"):
        raise ValueError(f"kind: expected place or room, got {show(kind)}")
    name = check_text("name", fields["name"], MAX_NAME_CHARS)
    return {"item": _item_here(name, kind), "here": True}


def _item_here(name: str, kind: str = "place") -> Item:
    """Return a place or room name; its position is set later, to that of the robot."""
    point = {"type": "Point", "coordinates": [0.0, 0.0]}
    properties = {"kind": kind, "name": name}
    return item_of({"type": "Feature", "properties": properties, "geometry": point})


def _check_import(fields: dict) -> dict:
    """Return the checked fields of `import`."""
    return {
        "site": site_of(without_mapped(fields.get("site"))),
        "replace": check_flag("replace", fields),
    }


SITE_VERBS = {
    "set": Verb(("name", "feature", "kind", "room"), _check_set),
    "remove": Verb(("name",), lambda fields: {"name": check_text("name", fields.get("name"))}),
    "import": Verb(("site", "replace"), _check_import),
    "list": Verb(read_only=True),
}
"""`{"do": "set", "name": NAME}` names the robot's pose, with `"kind": "room"` the room around it;
`{"do": "set", "kind": "keep_out" | "stay_inside", "room": ROOM}` makes a zone of a known room;
`{"do": "set", "feature": FEATURE}` adds a GeoJSON feature (see `edge.memory.site`);
`{"do": "remove", "name": NAME}`; `{"do": "import", "site": COLLECTION, "replace": BOOL}`;
`{"do": "list"}`. Each answers with the site."""


def handle_site(service: Service, request: Request, now_ns: int) -> dict:
    """Change the site as asked, or refuse and change nothing; return the site.

    Raises:
        UserError: the robot's pose is not known yet, or there is no such place or zone.
    """
    fields, site, text = request.fields, service.site.site, ""
    if request.do == "set":
        item = _zone_of(service, fields) if "room" in fields else fields["item"]
        if fields.get("here"):
            if service.pose is None:
                raise UserError("the robot's pose is not known yet: wait for the first observation")
            at_m = (service.pose.x_m, service.pose.y_m)
            is_room = isinstance(item, RoomName)
            item = RoomName(item.name, at_m) if is_room else Place.at(item.name, service.pose)
        service.change_site(site.with_item(item), now_ns)
        text = f"{describe_item(item)}{_other_names(service, item)}"
    elif request.do == "remove":
        service.change_site(site.without(fields["name"]), now_ns)
        text = f"removed: {name_of(fields['name'])}"
    elif request.do == "import":
        start = Site() if fields["replace"] else site
        service.change_site(reduce(Site.with_item, fields["site"].items, start), now_ns)
        text = f"imported: {len(fields['site'].items)} places and zones"
    if text:
        service.event(text, now_ns)
    return {"text": text, "site": service.site.known.geojson()}


def _other_names(service: Service, item: Item) -> str:
    """Return the other names of the room that gets a name, for the answer; "" if it has none."""
    if not isinstance(item, RoomName):
        return ""
    room_at = service.map.rooms.room_at
    room = room_at(*item.xy_m)
    others = [
        one.name
        for one in service.site.site.room_names
        if room is not None
        and room_at(*one.xy_m) is room
        and math.dist(one.xy_m, item.xy_m) > SAME_SPOT_M
    ]
    if not others:
        return ""
    return f"; it is also called {one_line(', '.join(others))}: remove a name that is wrong"


def _zone_of(service: Service, fields: dict) -> Zone:
    """Return a zone with the outline of a known room."""
    found = service.map.rooms.find(fields["room"])
    if len(found) != 1:
        known = one_line(", ".join(room.title for room in service.map.rooms.rooms) or "none")
        number = "no room" if not found else f"{len(found)} rooms"
        raise UserError(
            f"room: {number} called {bounded_repr(fields['room'])}, expected exactly one "
            f"(known: {known})"
        )
    corners = tuple((round(x, 3), round(y, 3)) for x, y in found[0].polygon_m.tolist())
    return Zone(fields["name"], fields["kind"], corners)


def describe_item(item: Item) -> str:
    """Return one line about a place, zone or room name."""
    name = one_line(item.name)
    if isinstance(item, RoomName):
        return f"room: {name} is the room around ({item.xy_m[0]:.2f}, {item.xy_m[1]:.2f})"
    if isinstance(item, Zone):
        words = "keep out of" if item.kind == "keep_out" else "stay inside"
        return f"zone: {words} {name} ({len(item.corners_m)} corners)"
    return f"place: {name} is ({item.pose.x_m:.2f}, {item.pose.y_m:.2f})"
