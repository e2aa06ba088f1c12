"""Questions to the object map: which objects were seen, at which place, and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.text import one_line

_MAX_NAMED = 5  # largest number of objects that an answer names


@dataclass(frozen=True, slots=True)
class KnownObject:
    """An object of the map.

    Attributes:
        xyz_m: centre in `map`.
        confidence: in [0, 1], mean over all looks at the place; see `TrackedObjects`.
        hits: number of images in which the object was detected.
        age_s: time since the object was seen last.
        known_s: time since the object was seen first.
        came_from_m: place (x, y) in `map` before the object was moved; None if it was not moved.
        room: name of the room that the object is in; "" if the room is not known.
    """

    id: int
    name: str
    xyz_m: tuple[float, float, float]
    confidence: float
    hits: int
    age_s: float
    known_s: float = 0.0
    came_from_m: tuple[float, float] | None = None
    room: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the object as a JSON-ready dict."""
        return {
            "id": self.id, "name": self.name, "xyz": [round(v, 3) for v in self.xyz_m],
            "confidence": round(self.confidence, 3), "hits": self.hits,
            "age_s": round(self.age_s, 1), "known_s": round(self.known_s, 1),
            "came_from": self.came_from_m and [round(v, 3) for v in self.came_from_m],
            "room": self.room,
        }  # fmt: skip


def known_objects(
    objects: TrackedObjects,
    stamp_ns: int,
    min_hits: int,
    name: str = "",
    most: int | None = None,
    since_s: float | None = None,
    is_in: Callable[[float, float], bool] | None = None,
    room_of: Callable[[float, float], str] = lambda x_m, y_m: "",
) -> list[KnownObject]:
    """Return the objects of the map, the most confident first.

    With a name, objects of exactly this name come before objects of a kind of it ("office chair"
    for "chair").

    Args:
        objects: objects of the map.
        stamp_ns: current time, on the sensors' clock.
        min_hits: objects that were detected in fewer images are left out.
        name: return only objects of this name and of its kinds; "" for all.
        most: largest number of objects to return; None for all.
        since_s: return only objects seen in the last `since_s` seconds; None for all.
        is_in: returns True if an object at (x, y) in `map` is wanted; None: all are.
        room_of: returns the title of the room at (x, y); "" if there is none.
    """
    s = objects
    # `s.words` are the different names; `s.word` is the index of each object's name.
    is_wanted = np.array([not name or names.is_kind_of(word, name) for word in s.words], np.bool_)
    rows = np.flatnonzero(s.hits[: s.n] >= min_hits)
    rows = rows[is_wanted[s.word[rows]]]
    if since_s is not None:
        rows = rows[stamp_ns - s.last_seen_ns[rows] <= since_s * 1e9]
    is_kind = np.array([name and not names.same_name(word, name) for word in s.words], np.bool_)
    # By name, then by confidence and id: `lexsort` has its first key last.
    rows = rows[np.lexsort((s.id[rows], -s.confidence[rows], is_kind[s.word[rows]]))]
    if is_in is not None:
        rows = rows[[is_in(x_m, y_m) for x_m, y_m in s.xyz_m[rows, :2].tolist()]]
    found: list[KnownObject] = []
    for i in rows[:most].tolist():
        x_m, y_m, z_m = s.xyz_m[i].tolist()
        age_s, known_s = (
            max(0.0, (stamp_ns - int(seen_ns[i])) * 1e-9)
            for seen_ns in (s.last_seen_ns, s.first_seen_ns)
        )
        found.append(
            KnownObject(
                int(s.id[i]), s.words[s.word[i]], (x_m, y_m, z_m), float(s.confidence[i]),
                int(s.hits[i]), age_s, known_s,
                tuple(s.came_from_m[i].tolist()) if s.moves[i] else None, room_of(x_m, y_m),
            )
        )  # fmt: skip
    return found


def describe_location(
    name: str,
    found: list[KnownObject],
    pose: SE2 | None,
    is_looked_for: bool,
    room_of: Callable[[float, float], str] = lambda x_m, y_m: "",
) -> str:
    """Return the answer to "where is the …?" in one line.

    Args:
        name: class of the object.
        found: the known objects of this name.
        pose: pose of the robot; None if it is not known.
        is_looked_for: False if the detector is not asked for this name, so no object of it can
            have been seen.
        room_of: returns the room of a point in words ("in the kitchen"); "" if there is none.
    """
    name = one_line(name)
    if not found:
        hint = "" if is_looked_for else ": the detector is not looking for it"
        return f"no {name} has been seen{hint}"
    texts = [_location_text(obj, pose, room_of) for obj in found[:_MAX_NAMED]]
    more = f"; {len(found) - _MAX_NAMED} more" if len(found) > _MAX_NAMED else ""
    return f"{name}: {'; '.join(texts)}{more}"


def describe_similar(
    name: str,
    similar: dict[str, list[KnownObject]],
    pose: SE2 | None,
    is_looked_for: bool,
    room_of: Callable[[float, float], str] = lambda x_m, y_m: "",
) -> str:
    """Return the answer if nothing of this name was seen, but objects of similar names were.

    Args:
        name: name that was asked for.
        similar: similar name → its known objects, the most similar name first.
        pose: see `describe_location`.
        is_looked_for: see `describe_location`.
        room_of: see `describe_location`.
    """
    texts = [
        f"a {one_line(word)} (similar) {_location_text(found[0], pose, room_of)}"
        for word, found in similar.items()
    ]
    return "; ".join((describe_location(name, [], pose, is_looked_for), *texts))


def _location_text(
    obj: KnownObject, pose: SE2 | None, room_of: Callable[[float, float], str]
) -> str:
    x_m, y_m, _ = obj.xyz_m
    distance = "" if pose is None else f", {pose.distance_to(x_m, y_m):.1f} m away"
    seen = "now" if obj.age_s < 1.0 else f"{_ago(obj.age_s)} ago"
    origin = ""
    if obj.came_from_m is not None:
        origin = ", probably moved from ({:.1f}, {:.1f})".format(*obj.came_from_m)
    room = f"{room}, " if (room := room_of(x_m, y_m)) else ""
    certainty = f"confidence {obj.confidence:.2f}{origin}"
    return f"{room}at ({x_m:.1f}, {y_m:.1f}){distance}, seen {seen}, {certainty}"


def _ago(age_s: float) -> str:
    """Return an age in a fitting unit, such as `5 min`."""
    for limit_s, unit_s, unit in ((120, 1, "s"), (7200, 60, "min"), (172_800, 3600, "h")):
        if age_s < limit_s:
            return f"{age_s / unit_s:.0f} {unit}"
    return f"{age_s / 86_400:.0f} days"
