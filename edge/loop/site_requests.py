"""Requests about places and zones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge.bus.verbs import Request, Verb, check_flag, check_text
from edge.errors import UserError
from edge.memory import Place, Site, Zone, item_of, merged, site_of
from edge.memory.site import MAX_NAME_CHARS, name_of
from edge.text import one_line

if TYPE_CHECKING:
    from edge.loop.service import Service


def _set(fields: dict) -> dict:
    if ("name" in fields) == ("feature" in fields):
        raise ValueError("do: set needs a name (the place is here) or a GeoJSON feature")
    if "feature" in fields:
        return {"item": item_of(fields["feature"])}
    here = {"type": "Point", "coordinates": [0.0, 0.0]}
    name = check_text("name", fields["name"], MAX_NAME_CHARS)
    properties = {"kind": "place", "name": name}
    feature = {"type": "Feature", "properties": properties, "geometry": here}
    return {"item": item_of(feature), "here": True}


def _import(fields: dict) -> dict:
    return {"site": site_of(fields.get("site")), "replace": check_flag("replace", fields)}


SITE_VERBS = {
    "set": Verb(("name", "feature"), _set),
    "remove": Verb(("name",), lambda fields: {"name": check_text("name", fields.get("name"))}),
    "import": Verb(("site", "replace"), _import),
    "list": Verb(reads=True),
}
"""`{"do": "set", "name": NAME}` names the robot's pose;
`{"do": "set", "feature": FEATURE}` adds a GeoJSON feature (see `edge.memory.site`);
`{"do": "remove", "name": NAME}`; `{"do": "import", "site": COLLECTION, "replace": BOOL}`;
`{"do": "list"}`. Each answers with the site."""


def handle_site(service: Service, request: Request, now_ns: int) -> dict:
    """Change the site as asked, or refuse and change nothing; return the site.

    Raises:
        UserError: the robot's pose is not known yet, or there is no such place or zone.
    """
    fields, site, done = request.fields, service.site.site, ""
    if request.do == "set":
        item = fields["item"]
        if fields.get("here"):
            if service.pose is None:
                raise UserError("the robot's pose is not known yet: wait for the first observation")
            item = Place.at(item.name, service.pose)
        service.change_site(site.with_item(item), now_ns)
        done = describe_item(item)
    elif request.do == "remove":
        service.change_site(site.without(fields["name"]), now_ns)
        done = f"removed: {name_of(fields['name'])}"
    elif request.do == "import":
        start = Site() if fields["replace"] else site
        service.change_site(merged(start, fields["site"].items), now_ns)
        done = f"imported: {len(fields['site'].items)} places and zones"
    if done:
        service.event(done, now_ns)
    return {"text": done, "site": service.site.known.geojson()}


def describe_item(item: Place | Zone) -> str:
    """Return one line about a place or zone."""
    name = one_line(item.name)
    if isinstance(item, Zone):
        words = "keep out of" if item.kind == "keep_out" else "stay inside"
        return f"zone: {words} {name} ({len(item.corners_m)} corners)"
    return f"place: {name} is ({item.pose.x_m:.2f}, {item.pose.y_m:.2f})"
