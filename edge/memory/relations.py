"""Objects that are described by a relation: "chair next to desk", "second door", "every mug".

A detector knows names, not relations. So it looks for the noun ("chair") and for the anchor
("desk"). The relation is then decided on the map of objects.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge import names, number_words
from edge.errors import UserError
from edge.memory.room_kinds import is_room_name
from edge.perception.tracking.instance_kernels import least_gap
from edge.text import one_line
from edge.types import Instance

NEXT_TO_M = 1.5
"""Largest planar distance between the surfaces of two objects that are next to each other."""
TOUCHING_M = 0.4
"""Largest planar distance between the surfaces of objects of which one is on or under the other.

Surfaces are seen from some sides only, so it is more than 0. Nearer to a reached object, another of
its name may be a part of it, and does not count as another one."""
PART_M = 0.8
"""Largest planar distance between two surfaces of one object, without floor between them: the end
of a sofa and a side of it, each seen alone. It is no larger than the larger surface."""
MOST_DESCRIBED = 64
"""Largest number of labels whose descriptions are kept."""
_CONTAINERS = """
    bag barrel basket bucket buggy cage can case cart crate crib cot cubby drawer folder jar locker
    packet pouch pram rack sack safe tin toolbox tray trolley tub wheelbarrow
"""
CONTAINERS = frozenset(_CONTAINERS.split())
"""Objects that may hold others and are not in the alias table."""

Relation = Literal["", "next to", "nearest to", "on", "under", "in"]
InstancesOf = Callable[[str], Sequence[Instance]]
"""Function that returns the instances of a name, best first."""
IsIn = Callable[[str, float, float], bool]
"""Function that returns True if the room of a name contains a point (x, y) in `map`."""
IsFloorBetween = Callable[[np.ndarray, np.ndarray], bool]
"""Function that returns True if the map has floor between two points in `map`."""

# Words of a relation → the relation.
_WORDS: dict[str, Relation] = {
    "next to": "next to", "beside": "next to", "near": "next to", "close to": "next to",
    "by": "next to", "at": "next to",
    "nearest to": "nearest to", "closest to": "nearest to", "nearest": "nearest to",
    "closest": "nearest to",
    "on top of": "on", "on": "on", "under": "under", "below": "under", "underneath": "under",
    "inside": "in", "in": "in",
}  # fmt: skip
_UNDECIDABLE = (
    "left of", "right of", "in front of", "behind", "opposite", "between", "against", "above",
    "far from", "farthest from",
)  # fmt: skip
_PHRASES = sorted((*_WORDS, *_UNDECIDABLE), key=len, reverse=True)
_SPLIT = re.compile(rf"^(?P<noun>.+?)\s+(?P<word>{'|'.join(_PHRASES)})\s+(?P<anchor>.+)$")

_COUNTED = re.compile(r"(?P<noun>.+) (?P<n>\w+) of (?P<of>\w+)")
_EVERY = "every "


class RelationError(UserError):
    """A description that cannot be decided on the object map. The message is one line."""


@dataclass(frozen=True, slots=True)
class DescribedObject:
    """An object with a relation that distinguishes it from others of its name.

    Attributes:
        relation: relation of the object to the anchor; "" if there is none.
        anchor: name of the other object; "" without a relation.
        room: name of the room that it must be in; "" for any.
        nth: number in the order in which such objects were seen: 2 for the second one; 0 for any.
        is_new: True for one that the mission has not reached yet: "chair 2 of 3", "every chair".
    """

    noun: str
    relation: Relation = ""
    anchor: str = ""
    room: str = ""
    nth: int = 0
    is_new: bool = False

    @property
    def prompts(self) -> tuple[str, ...]:
        """Names that the detector must look for, the noun first."""
        return (self.noun, self.anchor) if self.anchor else (self.noun,)


def parse_description(text: str) -> DescribedObject | None:
    """Return the object that a text describes by a relation; None if the text is a plain name.

    Raises:
        RelationError: the text has a relation that cannot be decided.

    >>> parse_description("the chair next to the desk").relation
    'next to'
    >>> parse_description("second door").nth, parse_description("office chair")
    (2, None)
    >>> parse_description("chair 2 of 3").is_new
    True
    """
    phrase = names.normalise(text)
    if names.is_known(phrase):
        return None
    room = ""
    if (found := _split_off_room(phrase)) is not None:
        phrase, room = found
    split = _SPLIT.match(phrase)
    relation: Relation = ""
    noun, anchor = phrase, ""
    if split is not None:
        if split["word"] in _UNDECIDABLE:
            raise _undecidable(text, f"{split['word']!r}")
        noun, relation = split["noun"], _WORDS[split["word"]]
        anchor = names.normalise(split["anchor"])
        if _SPLIT.match(anchor):
            raise _undecidable(text, "a second relation")
    nth, noun = _split_off_ordinal(noun)
    counted = _COUNTED.fullmatch(noun)
    is_new = counted is not None and all(number_words.number([n]) for n in counted.group("n", "of"))
    if counted is not None and is_new:
        noun = counted["noun"]
    elif noun.startswith(_EVERY):
        noun, is_new = noun.removeprefix(_EVERY), True
    if not (relation or room or nth or is_new):
        return None
    return DescribedObject(noun, relation, anchor, room, nth, is_new)


def without_room(text: str) -> str:
    """Return the description of an object without the room that it must be in.

    >>> without_room("every chair in the kitchen"), without_room("chair")
    ('every chair', 'chair')
    """
    found = _split_off_room(names.normalise(text))
    return text if found is None else found[0]


def _split_off_room(phrase: str) -> tuple[str, str] | None:
    """Return the phrase without its last "in ROOM", and the room; None if there is none.

    A word for no known object is the name that a person gave to a room.
    """
    for word in (" in ", " inside "):
        noun, _, text = phrase.rpartition(word)
        room = names.normalise(text)
        may_be_name = room and not _is_known(room) and not _SPLIT.match(room)
        if noun and (is_room_name(room) or may_be_name):
            return noun, room
    return None


def _is_known(name: str) -> bool:
    """Return True if a name or its last word is a known object: "toy box", "top drawer"."""
    head = names.singular(name.rpartition(" ")[2])
    return names.is_known(name) or names.is_known(head) or head in CONTAINERS


def _split_off_ordinal(noun: str) -> tuple[int, str]:
    """Return the number of "second door" and its name; 0 and the noun if it has no number."""
    first, _, rest = noun.partition(" ")
    nth = number_words.ordinal(first)
    if nth is None or not names.is_known(rest):
        return 0, noun
    return nth, rest


def _undecidable(text: str, what: str) -> RelationError:
    can = ", ".join(dict.fromkeys(_WORDS.values()))
    return RelationError(
        f"{one_line(text, 80)}: edge cannot check {what}; leave it out, name a room, or use one "
        f"of: {can}"
    )


class DescribedTargets:
    """Finds the instances that described targets mean, for `InstanceTracker.resolver`.

    Args:
        is_in: returns True if the room of a name contains a point (x, y) in `map`.
        is_floor_between: returns True if the map has floor between two points in `map`.
    """

    def __init__(self, is_in: IsIn, is_floor_between: IsFloorBetween) -> None:
        self._contains, self._is_floor_between = is_in, is_floor_between
        self._known: dict[str, DescribedObject | None] = {}

    def described(self, label: str) -> DescribedObject | None:
        """Return the object that a label describes; None if it is a plain name."""
        if label not in self._known:
            if len(self._known) >= MOST_DESCRIBED:
                self._known.clear()
            try:
                self._known[label] = parse_description(label)
            except RelationError:  # a label of a recording or a checkpoint; it names no instance
                self._known[label] = None
        return self._known[label]

    def resolve(self, label: str, of: InstancesOf, last: bool) -> list[Instance] | None:
        """Return the instances that a label describes, best first; None for a plain name.

        Args:
            label: a target.
            of: returns the instances of a name, best first.
            last: True if the search is over. "Nearest to" then accepts any distance.
        """
        described = self.described(label)
        if described is None:
            return None
        return [instance for instance, _ in self._ranked(described, of, last)]

    def reason_for(self, label: str, instance: Instance, of: InstancesOf) -> str:
        """Return why an instance is the one that a label describes; "" for a plain name."""
        described = self.described(label)
        found = () if described is None else self._ranked(described, of, last=True)
        return next((why for other, why in found if other.id == instance.id), "")

    def _ranked(
        self, described: DescribedObject, of: InstancesOf, last: bool
    ) -> list[tuple[Instance, str]]:
        """Return the instances that a description means, best first, each with the reason."""
        known = of(described.noun)
        found = [instance for instance in known if self._is_in(described.room, instance)]
        if described.is_new:
            reached = [instance for instance in known if instance.state == "reached"]
            found = [one for one in found if not any(self._may_be_one(one, it) for it in reached)]
        why = f"in the {described.room}" if described.room else ""
        if not described.relation:
            pairs = [(instance, why) for instance in found]
        else:
            anchors = list(of(described.anchor))
            limit_m = NEXT_TO_M if described.relation in ("next to", "nearest to") else TOUCHING_M
            if described.relation == "nearest to" and last:
                limit_m = math.inf
            pairs = list(_found_near(described, found, anchors, limit_m))
        if not described.nth:
            return pairs
        by_age = sorted(pairs, key=lambda pair: pair[0].id)  # ids grow with the first sighting
        ordinal = f"number {described.nth} in the order of seeing"
        return [
            (instance, f"{ordinal}{', ' * bool(place)}{place}")
            for instance, place in by_age[described.nth - 1 :][:1]
        ]

    def _may_be_one(self, instance: Instance, other: Instance) -> bool:
        """Return True if two instances of a name may be parts of one object."""
        if other.id in instance.apart:
            return False
        gap_m, row, other_row = least_gap(instance.points_m, other.points_m)
        surface_m = max(float(np.ptp(one.points_m[:, :2], 0).max()) for one in (instance, other))
        if gap_m <= TOUCHING_M or gap_m > min(PART_M, surface_m):
            return gap_m <= TOUCHING_M
        return not self._is_floor_between(instance.points_m[row], other.points_m[other_row])

    def _is_in(self, room: str, instance: Instance) -> bool:
        return not room or self._contains(room, *instance.center_m[:2].tolist())


def _found_near(
    described: DescribedObject,
    found: Sequence[Instance],
    anchors: Sequence[Instance],
    limit_m: float,
) -> Iterator[tuple[Instance, str]]:
    """Yield the objects within a distance of an anchor, with the reason.

    For "nearest to" only the nearest one is yielded. For the other relations the order is kept.
    """
    found_near: list[tuple[float, Instance, str]] = []
    for instance in found:
        gaps = [
            (least_gap(instance.points_m, other.points_m)[0], other) for other in anchors
            if other.id != instance.id and _is_level(described.relation, instance, other)
        ]  # fmt: skip
        if not gaps:
            continue
        gap_m, other = min(gaps, key=lambda pair: (pair[0], pair[1].id))
        if gap_m <= limit_m:
            found_near.append((gap_m, instance, f"{gap_m:.1f} m from {other.label} {other.id}"))
    if described.relation == "nearest to":
        found_near = sorted(found_near, key=lambda each: (each[0], each[1].id))[:1]
    yield from ((instance, why) for _, instance, why in found_near)


def _is_level(relation: Relation, instance: Instance, other: Instance) -> bool:
    """Return True if the heights of two objects fit "on" or "under"; True for other relations."""
    z_m, other_z_m = float(instance.center_m[2]), float(other.center_m[2])
    return {"on": z_m > other_z_m, "under": z_m < other_z_m}.get(relation, True)
