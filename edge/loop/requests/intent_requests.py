"""Answers to instructions that are no mission: questions, and orders to learn a place or zone.

The parser of instructions gives the intent (`edge.mission.language.intents`). The site holds the
places and zones that people gave (`service.site.site`); `service.site.known` has the place `start`
in addition.

`handlers` calls `carry_out` for them: "where is the mug?", "this is the kitchen".
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from edge import names
from edge.bus.verbs import Request, Verb, read_request
from edge.errors import UserError
from edge.geometry import SE2
from edge.loop.requests.memory_requests import MEMORY_VERBS, handle_memory
from edge.loop.requests.site_requests import SITE_VERBS, handle_site
from edge.memory.site import is_same
from edge.mission.language.intents import MemoryQuestion, SiteOrder
from edge.text import one_line

if TYPE_CHECKING:
    from edge.loop.service import Service

_MAX_NAMES = 20
_HELP = (
    "say for example: 'find my keys', 'go to the kitchen, then come back', 'explore the hall', "
    "'check if the stove is in the kitchen', 'wait two minutes', 'remember this as the dock', "
    "'stay out of the bathroom', 'where is the mug?', 'stop', 'go on'"
)
_NEAR_M = 1.5  # distance between the centres of two objects that are near each other


def carry_out(service: Service, intent: MemoryQuestion | SiteOrder, now_ns: int) -> str:
    """Answer a question, or change the site as ordered; return the answer in one line.

    Raises:
        UserError: it cannot be done. Nothing has changed then.
    """
    if isinstance(intent, MemoryQuestion):
        return _answer(service, intent, now_ns)
    return _change_site(service, intent, now_ns)


def _call_handler(
    handle: Any, verbs: Mapping[str, Verb], service: Service, now_ns: int, **data: Any
) -> dict:
    """Check a request like one that came over the bus, and return its answer."""
    try:
        do, fields = read_request(json.dumps(data).encode(), verbs)
    except ValueError as error:
        raise UserError(str(error)) from error
    answer: dict = handle(service, Request(do, fields), now_ns)
    return answer


def _answer(service: Service, intent: MemoryQuestion, now_ns: int) -> str:
    """Return the answer to a question in one line."""
    if intent.topic in ("where", "exists", "count"):
        name = names.head_phrase(intent.about)
        name = names.singular(name) if intent.topic == "count" else name
        answer = _call_handler(handle_memory, MEMORY_VERBS, service, now_ns, do="find", name=name)
        in_room = _in_room(service, answer["objects"], intent.room)
        text = str(answer["text"])
        # Without an object of this name, the answer has similar ones.
        number = sum(_is_of(one, name) for one in in_room)
        if intent.room and answer["objects"] and not number:
            return f"none in the {one_line(intent.room)}; {text}"
        # Memory does not know which boxes are on the shelf.
        counts = intent.topic == "count" and names.head_phrase(intent.about) == intent.about
        if counts and number:
            room = f" in the {one_line(intent.room)}" if intent.room else ""
            return f"{number} {name if number == 1 else names.plural(name)} seen{room}; {text}"
        return f"yes, {text}" if intent.topic == "exists" and number else text
    if intent.topic == "seen":
        answer = _call_handler(handle_memory, MEMORY_VERBS, service, now_ns, do="list")
        in_room = _in_room(service, answer["objects"], intent.room)
        if intent.about:
            return _seen_near(service, intent.about, in_room, now_ns)
        return _counted_names("seen", [one["name"] for one in in_room])
    if intent.topic == "doing":
        status = service.status
        return ": ".join(filter(None, (status.instruction, status.phase, status.reason)))
    if intent.topic == "help":
        return _HELP
    if intent.topic == "places":
        return _counted_names("places", [place.name for place in service.site.known.places])
    if intent.topic == "rooms":
        return _counted_names("rooms", [room.title for room in service.map.rooms.rooms])
    # "where are you?"
    pose = _pose(service)
    room = service.map.rooms.room_phrase(pose.x_m, pose.y_m)
    at = f"at ({pose.x_m:.1f}, {pose.y_m:.1f})"
    return f"{room}, {at}" if room else at


def _pose(service: Service) -> SE2:
    """Return the robot's pose; raise UserError if it is not known yet."""
    if service.pose is None:
        raise UserError("the robot's pose is not known yet: wait for the first observation")
    return service.pose


def _in_room(service: Service, objects: list[dict], name: str) -> list[dict]:
    """Return the objects in the rooms of a name; all if it is ""."""
    if not name:
        return objects
    rooms = service.map.rooms
    ids = {room.id for room in rooms.find(name)}
    if not ids:
        known = one_line(", ".join(room.title for room in rooms.rooms) or "none")
        raise UserError(f"no room called {one_line(name)} is known (known: {known})")
    at = [rooms.room_at(*one["xyz"][:2]) for one in objects]
    return [one for one, room in zip(objects, at, strict=True) if room and room.id in ids]


def _is_of(found: dict, name: str) -> bool:
    """Return True if an object is of this name, and not only similar."""
    return names.is_kind_of(found["name"], name)


def _seen_near(service: Service, name: str, objects: list[dict], now_ns: int) -> str:
    """Return what is near the known objects of a name, or that there are none.

    The memory has no surfaces, so it cannot tell what is on an object from what is next to it.
    """
    answer = _call_handler(handle_memory, MEMORY_VERBS, service, now_ns, do="find", name=name)
    # Without an object of this name, the answer has similar ones.
    anchors = [one for one in answer["objects"] if _is_of(one, name)]
    if not anchors:
        return str(answer["text"])
    near = [
        one["name"]
        for one in objects
        if all(one["id"] != anchor["id"] for anchor in anchors)
        and any(_are_near(one, anchor) for anchor in anchors)
    ]
    return _counted_names(f"within {_NEAR_M:g} m of the {one_line(name)}", near)


def _are_near(one: dict, other: dict) -> bool:
    same_room = one["room"] == other["room"] or not (one["room"] and other["room"])
    return same_room and math.dist(one["xyz"][:2], other["xyz"][:2]) <= _NEAR_M


def _counted_names(title: str, found: list[str]) -> str:
    """Return the names with their numbers, the most frequent first."""
    counts = Counter(found).most_common(_MAX_NAMES)
    shown = [f"{n} × {one_line(name)}" if n > 1 else one_line(name) for name, n in counts]
    more = ", …" if len(set(found)) > _MAX_NAMES else ""
    return f"{title}: {', '.join(shown) or 'none'}{more}"


def _change_site(service: Service, intent: SiteOrder, now_ns: int) -> str:
    """Add or remove a place, room name or zone; return the answer in one line."""
    data: dict[str, Any]
    if intent.do == "place":
        data = {"do": "set", "name": intent.name}
    elif intent.do == "room":
        data = {"do": "set", "kind": "room", "name": intent.name}
    elif intent.do in ("keep_out", "stay_inside"):
        data = {"do": "set", "kind": intent.do, "room": intent.name or _room_here(service)}
    elif intent.do == "open":
        data = {"do": "remove", "name": _zone_to_open(service, intent.name)}
    else:
        data = {"do": "remove", "name": intent.name}
    return str(_call_handler(handle_site, SITE_VERBS, service, now_ns, **data)["text"])


def _room_here(service: Service) -> str:
    """Return the title of the room that the robot is in."""
    pose = _pose(service)
    room = service.map.rooms.room_at(pose.x_m, pose.y_m)
    if room is None:
        raise UserError("the room here is not known yet: explore it first, or draw a zone")
    return room.title


def _zone_to_open(service: Service, name: str) -> str:
    """Return the name of the zone of a room; for "" that of the only room to stay inside."""
    zones = service.site.site.zones
    if name:
        wanted = (name, f"{name} zone")
        found = [zone.name for zone in zones if any(is_same(zone.name, one) for one in wanted)]
    else:
        found = [zone.name for zone in zones if zone.kind == "stay_inside"]
    if len(found) != 1:
        listed = one_line(", ".join(zone.name for zone in zones) or "none")
        number = "no zone has" if not found else f"{len(found)} zones have"
        raise UserError(
            f"{one_line(name) or 'this room'}: {number} this name; name one of the zones: {listed}"
        )
    return found[0]
