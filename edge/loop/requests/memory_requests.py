"""Requests about what the service remembers: its objects, their pictures, and the rooms.

`edge memory` and the live page send them, with the key `memory/request`.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from edge import names
from edge.bus.verbs import Request, Verb, check_text, show
from edge.errors import UserError
from edge.memory import describe_location, describe_similar, known_objects
from edge.memory.site import MAX_NAME_CHARS, name_of
from edge.text import one_line

if TYPE_CHECKING:
    from edge.loop.scoring.prior import LocationPrior
    from edge.loop.service import Service


def _check_filters(fields: dict) -> dict:
    """Return the filters of a request after a check."""
    found: dict = {}
    if "room" in fields:
        found["room"] = name_of(check_text("room", fields["room"], MAX_NAME_CHARS))
    if "since_s" in fields:
        since_s = fields["since_s"]
        if type(since_s) not in (int, float) or not 0 <= since_s < float("inf"):
            raise ValueError(f"since_s: expected seconds, 0 or more, got {show(since_s)}")
        found["since_s"] = since_s
    return found


def _check_find(fields: dict) -> dict:
    name = name_of(check_text("name", fields.get("name"), MAX_NAME_CHARS))
    return {"name": name, **_check_filters(fields)}


def _check_crop(fields: dict) -> dict:
    if type(fields.get("id")) is not int:
        raise ValueError(f"id: expected the id of an object, got {show(fields.get('id'))}")
    return {"id": fields["id"]}


_MOST_SIMILAR = 3
_FILTERS = ("room", "since_s")
MEMORY_VERBS = {
    "find": Verb(("name", *_FILTERS), _check_find, read_only=True),
    "list": Verb(_FILTERS, _check_filters, read_only=True),
    "crop": Verb(("id",), _check_crop, read_only=True),
    "rooms": Verb(read_only=True),
}
"""`{"do": "find", "name": "mug"}` or `{"do": "list"}`; both answer with `text` and `objects`, and
take the filters `room` and `since_s`. `{"do": "crop", "id": 3}` answers with `jpeg_base64`,
`{"do": "rooms"}` with `text` and `rooms`."""


def handle_memory(service: Service, request: Request, now_ns: int) -> dict:
    """Return the known objects of a name, or all; the picture of one; or the rooms.

    See `MEMORY_VERBS` for the keys of the answer.

    Raises:
        UserError: there is no picture of the object, or no room of this name.
    """
    rooms = service.map.rooms
    if request.do == "rooms":
        known_rooms = [room.to_json() for room in rooms.rooms]
        return {"text": f"{len(known_rooms)} rooms", "rooms": known_rooms}
    if request.do == "crop":
        return _picture(service, request.fields["id"])
    name, room = request.fields.get("name", ""), request.fields.get("room", "")
    if room and not rooms.matching(room):
        raise UserError(f"room: no room called {one_line(room)} is known; `do: rooms` lists them")
    objects, pose = service.map.objects.read_only, service.pose
    known = partial(
        known_objects, objects, service.stamp_ns, service.config.perception.min_hits,
        since_s=request.fields.get("since_s"), room_of=rooms.title_at,
        is_in=partial(rooms.is_in, room) if room else None,
    )  # fmt: skip
    found = known(name=name)
    if name:
        prompted = (*service.mission.spec.prompts, *objects.words)
        is_looked_for = any(names.is_kind_of(word, name) for word in prompted)
        text = describe_location(name, found, pose, is_looked_for, rooms.room_phrase)
        if not found:
            words = similar_words(name, objects.words, service.map.prior)
            similar = {word: seen for word in words if (seen := known(name=word))}
            text = describe_similar(name, similar, pose, is_looked_for, rooms.room_phrase)
            found = [one for seen in similar.values() for one in seen]
    else:
        text = f"{len(found)} objects"
    return {"text": text, "objects": [one.to_json() for one in found]}


def similar_words(name: str, words: Sequence[str], prior: LocationPrior | None) -> list[str]:
    """Return the words that mean a similar object, most similar first: at most three.

    The first words have similar text embeddings in the detector's vocabulary, which the prior
    holds. The next ones are in the table of objects that look alike (`edge.names.NEAR`).
    """
    near = [] if prior is None else prior.words.alike(name, words)
    near += [word for word in words if names.look_alike(word, name)]
    return list(dict.fromkeys(near))[:_MOST_SIMILAR]


def _picture(service: Service, object_id: int) -> dict:
    """Return the answer to `crop`: the picture of an object, its crop from the best image."""
    jpeg = service.map.crops.get(object_id)
    if jpeg is None:
        raise UserError(
            f"id: there is no picture of an object {object_id}; `do: list` gives the ids of objects"
        )
    return {
        "text": f"object {object_id}: {len(jpeg)} bytes of JPEG",
        "jpeg_base64": base64.b64encode(jpeg).decode(),
    }
