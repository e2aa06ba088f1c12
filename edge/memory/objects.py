"""Questions to the object map: what was seen, where and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.perception.tracking.sightings import TrackedObjects
from edge.text import one_line

_MOST_TOLD = 5


@dataclass(frozen=True, slots=True)
class KnownObject:
    """An object of the map.

    Attributes:
        xyz_m: centre in `map`.
        confidence: in [0, 1], mean over all looks at the place; see `TrackedObjects`.
        hits: number of images that it was detected in.
        age_s: time since it was seen last.
        known_s: time since it was seen first.
        came_from_m: place (x, y) in `map` before it was moved; None if it was not.
        room: name of its room; "" if it is not known.
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
        """Return it JSON-ready."""
        return {
            "id": self.id, "name": self.name, "xyz": [round(v, 3) for v in self.xyz_m],
            "confidence": round(self.confidence, 3), "hits": self.hits,
            "age_s": round(self.age_s, 1), "known_s": round(self.known_s, 1),
            "came_from": self.came_from_m and [round(v, 3) for v in self.came_from_m],
            "room": self.room,
        }  # fmt: skip


def known_objects(
    sightings: TrackedObjects,
    stamp_ns: int,
    min_hits: int,
    name: str = "",
    most: int | None = None,
    since_s: float | None = None,
    is_in: Callable[[float, float], bool] | None = None,
    room_of: Callable[[float, float], str] = lambda x_m, y_m: "",
) -> list[KnownObject]:
    """Return the objects of the map, the most confident first; kinds of a name after the name.

    Args:
        sightings: objects of the map.
        stamp_ns: now, on the sensors' clock.
        min_hits: leave out what was detected in fewer images.
        name: only these and kinds of them; empty for all.
        most: limit of their number.
        since_s: only those seen in the last seconds; None for all.
        is_in: returns True if an object at (x, y) in `map` is wanted; None: all are.
        room_of: returns the title of the room at (x, y); "" if there is none.
    """
    s = sightings
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


def where_is(
    name: str,
    found: list[KnownObject],
    pose: SE2 | None,
    is_looked_for: bool,
    room_of: Callable[[float, float], str] = lambda x_m, y_m: "",
) -> str:
    """Return the answer to "where is the …?" in one line.

    Args:
        name: class of the object.
        found: of this name.
        pose: the robot's; None if it is not known.
        is_looked_for: False if the detector is not asked for it, so it cannot have been seen.
        room_of: returns the room of a point in words ("in the kitchen"); "" if there is none.
    """
    name = one_line(name)
    if not found:
        hint = "" if is_looked_for else ": the detector is not looking for it"
        return f"no {name} has been seen{hint}"
    texts = [_place(one, pose, room_of) for one in found[:_MOST_TOLD]]
    more = f"; {len(found) - _MOST_TOLD} more" if len(found) > _MOST_TOLD else ""
    return f"{name}: {'; '.join(texts)}{more}"


def similar_is(
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
        pose: see `where_is`.
        is_looked_for: see `where_is`.
        room_of: see `where_is`.
    """
    texts = [
        f"a {one_line(word)} (similar) {_place(found[0], pose, room_of)}"
        for word, found in similar.items()
    ]
    return "; ".join((where_is(name, [], pose, is_looked_for), *texts))


def _place(one: KnownObject, pose: SE2 | None, room_of: Callable[[float, float], str]) -> str:
    x_m, y_m, _ = one.xyz_m
    away = "" if pose is None else f", {pose.distance_to(x_m, y_m):.1f} m away"
    seen = "now" if one.age_s < 1.0 else f"{_ago(one.age_s)} ago"
    moved = ""
    if one.came_from_m is not None:
        moved = ", probably moved from ({:.1f}, {:.1f})".format(*one.came_from_m)
    room = f"{room}, " if (room := room_of(x_m, y_m)) else ""
    certain = f"confidence {one.confidence:.2f}{moved}"
    return f"{room}at ({x_m:.1f}, {y_m:.1f}){away}, seen {seen}, {certain}"


def _ago(age_s: float) -> str:
    for limit_s, unit_s, unit in ((120, 1, "s"), (7200, 60, "min"), (172_800, 3600, "h")):
        if age_s < limit_s:
            return f"{age_s / unit_s:.0f} {unit}"
    return f"{age_s / 86_400:.0f} days"
