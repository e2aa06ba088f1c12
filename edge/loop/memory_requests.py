"""Questions to the object map of the running service."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge import names
from edge.bus.verbs import Request, Verb, check_text
from edge.memory import known_objects, where_is
from edge.memory.site import MAX_NAME_CHARS, name_of

if TYPE_CHECKING:
    from edge.loop.service import Service


def _find(fields: dict) -> dict:
    return {"name": name_of(check_text("name", fields.get("name"), MAX_NAME_CHARS))}


MEMORY_VERBS = {
    "find": Verb(("name",), _find, reads=True),
    "list": Verb(reads=True),
    "rooms": Verb(reads=True),
}
"""`{"do": "find", "name": "mug"}` or `{"do": "list"}`; both answer with `text` and `objects`.
`{"do": "rooms"}` answers with `text` and `rooms`."""


def handle_memory(service: Service, request: Request, now_ns: int) -> dict:
    """Return the known objects of a name, or all; or the rooms."""
    if request.do == "rooms":
        rooms = [room.to_json() for room in service.map.rooms.rooms]
        return {"text": f"{len(rooms)} rooms", "rooms": rooms}
    perception, name = service.config.perception, request.fields.get("name", "")
    sightings, pose = service.map.sightings.shown, service.pose
    found = known_objects(sightings, service.stamp_ns, perception.min_hits, name)
    if name:
        asked = (*service.mission.brief.prompts, *sightings.words)
        is_looked_for = any(names.is_kind_of(word, name) for word in asked)
        text = where_is(name, found, pose, is_looked_for, service.map.rooms.where)
    else:
        text = f"{len(found)} objects"
    return {"text": text, "objects": [one.to_json() for one in found]}
