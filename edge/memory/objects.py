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
    """

    id: int
    name: str
    xyz_m: tuple[float, float, float]
    confidence: float
    hits: int
    age_s: float

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "id": self.id, "name": self.name, "xyz": [round(v, 3) for v in self.xyz_m],
            "confidence": round(self.confidence, 3), "hits": self.hits,
            "age_s": round(self.age_s, 1),
        }  # fmt: skip


def known_objects(
    sightings: TrackedObjects,
    stamp_ns: int,
    min_hits: int,
    name: str = "",
    most: int | None = None,
) -> list[KnownObject]:
    """Return the objects of the map, the most confident first; kinds of a name after the name.

    Args:
        sightings: objects of the map.
        stamp_ns: now, on the sensors' clock.
        min_hits: leave out what was detected in fewer images.
        name: only these and kinds of them; empty for all.
        most: limit of their number.
    """
    s = sightings
    is_wanted = np.array([not name or names.is_kind_of(word, name) for word in s.words], np.bool_)
    rows = np.flatnonzero(s.hits[: s.n] >= min_hits)
    rows = rows[is_wanted[s.word[rows]]]
    is_kind = np.array([name and not names.same_name(word, name) for word in s.words], np.bool_)
    # By name, then by confidence and id: `lexsort` has its first key last.
    order = np.lexsort((s.id[rows], -s.confidence[rows], is_kind[s.word[rows]]))
    rows = rows[order][:most]
    return [
        KnownObject(
            int(s.id[i]), s.words[s.word[i]], (x_m, y_m, z_m), float(s.confidence[i]),
            int(s.hits[i]), max(0.0, (stamp_ns - int(s.last_seen_ns[i])) * 1e-9),
        )
        for i, (x_m, y_m, z_m) in zip(rows.tolist(), s.xyz_m[rows].tolist(), strict=True)
    ]  # fmt: skip


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
    rooms = [room_of(*one.xyz_m[:2]) for one in found[:_MOST_TOLD]]
    texts = [
        f"{room}, {_place(one, pose)}" if room else _place(one, pose)
        for one, room in zip(found, rooms, strict=False)
    ]
    more = f"; {len(found) - _MOST_TOLD} more" if len(found) > _MOST_TOLD else ""
    return f"{name}: {'; '.join(texts)}{more}"


def _place(one: KnownObject, pose: SE2 | None) -> str:
    x_m, y_m, _ = one.xyz_m
    away = "" if pose is None else f", {pose.distance_to(x_m, y_m):.1f} m away"
    seen = "now" if one.age_s < 1.0 else f"{_ago(one.age_s)} ago"
    return f"at ({x_m:.1f}, {y_m:.1f}){away}, seen {seen}, confidence {one.confidence:.2f}"


def _ago(age_s: float) -> str:
    for limit_s, unit_s, unit in ((120, 1, "s"), (7200, 60, "min"), (172_800, 3600, "h")):
        if age_s < limit_s:
            return f"{age_s / unit_s:.0f} {unit}"
    return f"{age_s / 86_400:.0f} days"
