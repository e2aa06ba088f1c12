"""Destinations: propositions that are no objects to search for, such as places and waits.

The text of a proposition decides which destination it is; see `destination_of`. So a proposition
means the same in a formula that a person wrote, and as a quoted name in an instruction. `kind` of
each class distinguishes the classes in JSON.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union

from pydantic import ConfigDict, Discriminator, Field, TypeAdapter

from edge import names, number_words
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import RECOGNISED_KINDS, Place, Site, kind_of_room, parse_description
from edge.mission.language.words import nouns
from edge.mission.language.words.everyday_words import is_room
from edge.mission.language.words.places import EVERY, EXPLORED, HERE, NO, START
from edge.mission.language.words.spans import shown_s
from edge.text import one_line

CALLER = "caller"
"""Name of the place whose pose a request gives as `from_pose`."""
LONGEST_S = 24 * 3600.0
"""Longest duration of a wait, an exploration or a repetition."""
# Unit → its length [s].
_UNITS_S = {"s": 1, "sec": 1, "second": 1, "min": 60, "minute": 60, "h": 3600, "hour": 3600}
DURATION = r"[\w.]+(?:\s+\w+)?\s+(?:s|secs?|seconds?|mins?|minutes?|h|hours?)"
"""Pattern of a text for `duration_s`."""
_TIME_OF_DAY = r"(?:[01]\d|2[0-3]):[0-5]\d"  # "09:00"
_WAIT = re.compile(rf"wait(?: until (?P<until>{_TIME_OF_DAY})| (?:for )?(?P<time>{DURATION}))?")
_EXPLORE = re.compile(rf"{EXPLORED}(?: (?!for )(?P<room>.+?))?(?: for (?P<time>{DURATION}))?")
_CANNOT_FAIL = re.compile(rf"{HERE}$|wait\b|{NO}")  # after NO
_CHECK = re.compile(r"check (?:the )?(?P<name>.+?)(?: in (?:the )?(?P<room>.+))?")
_ROOM_NUMBER = re.compile(r"room (?P<n>\w+)")
_EVERY = re.compile(rf"{EVERY} (?P<name>.+)")
_ROOM_WITH = re.compile(r"room with (?:(?:the|a|an) )?(?P<name>.+)")

Name = Annotated[str, Field(max_length=1000)]
Seconds = Annotated[float, Field(gt=0, le=LONGEST_S)]
TimeOfDay = Annotated[str, Field(pattern=f"^{_TIME_OF_DAY}$")]


class DestinationError(UserError):
    """A destination that cannot be used; one line."""


class _Strict:
    """Base of the destinations: their JSON has no other fields, and only finite numbers."""

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class PlaceTarget(_Strict):
    """A pose to stop at.

    Attributes:
        pose: in `map`; None for `start` and `here` until the mission begins.
    """

    pose: SE2 | None = None
    kind: Literal["place"] = "place"


@dataclass(frozen=True, slots=True)
class ExploreTarget(_Strict):
    """Exploration, reached when no reachable frontier is left or the time is over.

    Attributes:
        room: name of the room to explore; "" for everything.
        limit_s: time after which it ends; None for no limit.
    """

    room: Name = ""
    limit_s: Seconds | None = None
    kind: Literal["explore"] = "explore"


@dataclass(frozen=True, slots=True)
class WaitTarget(_Strict):
    """A wait at the robot's position.

    Attributes:
        seconds: duration; None: wait until a person orders to go on, or until `until`.
        until: time of day as "09:00", in the local time of the robot's computer; not with
            `seconds`.
    """

    seconds: Seconds | None = None
    until: TimeOfDay | None = None
    kind: Literal["wait"] = "wait"

    def __post_init__(self) -> None:
        if self.seconds is not None and self.until is not None:
            raise ValueError("a wait has a duration or a time of day, not both")

    @property
    def shown(self) -> str:
        """Its end after the word "wait": "10 min", "until 09:00"."""
        if self.until is not None:
            return f"until {self.until}"
        return "until told to go on" if self.seconds is None else shown_s(self.seconds)


@dataclass(frozen=True, slots=True)
class CheckTarget(_Strict):
    """A check if an object is there; either answer fulfils it.

    Attributes:
        room: name of the room to look in; "" for everywhere.
    """

    name: Name
    room: Name = ""
    kind: Literal["check"] = "check"


@dataclass(frozen=True, slots=True)
class RoomTarget(_Strict):
    """A room, reached when the robot is inside.

    Attributes:
        name: name of a room or kind of room, or "room 3"; for `with`, name of the object in it.
        which: `called` by its name, `largest`, `next` (the nearest unvisited one), or `with` a
            object.
    """

    name: Name = ""
    which: Literal["called", "largest", "next", "with"] = "called"
    kind: Literal["room"] = "room"


@dataclass(frozen=True, slots=True)
class EveryRoomTarget(_Strict):
    """A tour of rooms, reached when the robot was in each one that it can get into.

    Attributes:
        room: kind of the rooms; "" for all rooms.
    """

    room: Name = ""
    kind: Literal["every_room"] = "every_room"


@dataclass(frozen=True, slots=True)
class EveryObjectTarget(_Strict):
    """All objects of a name, reached when the robot was at each one and all is explored.

    Attributes:
        name: name or description of one such object.
        room: name of the room to look in; "" for everywhere.
    """

    name: Name
    room: Name = ""
    kind: Literal["every_object"] = "every_object"


@dataclass(frozen=True, slots=True)
class FailureTarget(_Strict):
    """The failure of another target of the mission: it was given up, "no mug" for "mug".

    It is never pursued. It becomes true when the other target has failed and the plan needs it.
    Only formulas name it: the English name "no entry sign" is an object.
    """

    target: Name
    kind: Literal["failure"] = "failure"


Destination = Annotated[
    Union[
        PlaceTarget,
        ExploreTarget,
        WaitTarget,
        CheckTarget,
        RoomTarget,
        EveryRoomTarget,
        EveryObjectTarget,
        FailureTarget,
    ],
    Discriminator("kind"),
]
_DESTINATIONS: TypeAdapter[dict[str, Destination]] = TypeAdapter(dict[Name, Destination])


def destination_of(text: str, site: Site) -> Destination | None:
    """Return the destination that a proposition means, or None if it is an object to search for.

    The canonical phrases are `start`, `here`, `caller`, the names of places, `explored`,
    `explored kitchen`, `explored for 10 min`, `wait`, `wait 30 s`, `wait until 09:00`,
    `check stove`, `check kettle in kitchen`, the names of rooms and their kinds, `room 3`,
    `largest room`, `next room`, `room with sofa`, `every room`, `every bedroom` and
    `every chair in kitchen`. A place of the site comes before a phrase, and a room's name before a
    kind. A kind of room that the robot cannot recognise is an object, unless a person gave a room
    that name.

    Raises:
        DestinationError: a duration is no number or too long, a time of day is none, or the
            caller's pose is not known.
        RelationError: see `parse_description`.

    Example:
        >>> destination_of("sofa", Site()) is None
        True
        >>> [destination_of(text, Site()).shown for text in ("wait 2 min", "wait until 09:00")]
        ['2 min', 'until 09:00']
    """
    place = site.place(text)
    if place is not None:
        return PlaceTarget(place.pose)
    text = names.normalise(text)
    if text in (START, HERE):
        return PlaceTarget()
    if text == CALLER:
        raise DestinationError(
            "caller: the request does not say where the caller is; "
            "send from_pose: [x_m, y_m, yaw_rad] with it"
        )
    if found := _WAIT.fullmatch(text):
        return WaitTarget(found["time"] and duration_s(found["time"]), found["until"])
    if text.startswith("wait until "):
        raise DestinationError(
            f"{one_line(text, 60)}: expected a time of day from 00:00 to 23:59, as in "
            '"wait until 09:00"'
        )
    if found := _EXPLORE.fullmatch(text):
        room = _room_name_of(found["room"], site)
        return ExploreTarget(room, found["time"] and duration_s(found["time"]))
    if found := _CHECK.fullmatch(text):
        name, room = found["name"], found["room"] or ""
        is_object = not is_room(room) and nouns.unknown_in(room.split()) is None
        if room and is_object and _room_of(room, site) is None:  # "milk in the fridge"
            return CheckTarget(f"{name} in the {room}")
        return CheckTarget(name, _room_name_of(room, site))
    if found := _EVERY.fullmatch(text):
        name, described = found["name"], parse_description(found["name"])
        if described is None and (is_room(name) or site.room_name(name)):
            return EveryRoomTarget("" if name == "room" else _room_name_of(name, site))
        if described is not None and (described.nth or described.is_new):
            raise DestinationError(f"{one_line(text, 60)}: say 'every' or a number, not both")
        return EveryObjectTarget(name, _room_name_of(described and described.room, site))
    return _room_of(text, site)


def failure_of(text: str, targets: Iterable[str]) -> FailureTarget | None:
    """Return the failure that a proposition means, if the rest of its text is another target.

    Example:
        >>> failure_of("no mug", ["mug", "no mug"])
        FailureTarget(target='mug', kind='failure')
        >>> failure_of("no entry sign", ["no entry sign"]) is None
        True

    Raises:
        DestinationError: the target cannot fail, such as a wait.
    """
    if text.startswith(NO) and _CANNOT_FAIL.match(text, len(NO)):
        raise DestinationError(f"mission: {one_line(text)}: this cannot fail; leave it out")
    key = names.canonical(text.removeprefix(NO)) if text.startswith(NO) else ""
    found = (target for target in targets if key and names.canonical(target) == key)
    return next(map(FailureTarget, found), None)


def room_target(text: str) -> RoomTarget:
    """Return the room that a normalised name means, if it means one."""
    if text in ("largest room", "biggest room"):
        return RoomTarget(which="largest")
    if text == "next room":
        return RoomTarget(which="next")
    if found := _ROOM_WITH.fullmatch(text):
        return RoomTarget(found["name"], "with")
    return RoomTarget(text)


def _room_name_of(text: str | None, site: Site) -> str:
    """Return the name of the room in a phrase, without its article; "" if there is none."""
    name = (text or "").removeprefix("the ")
    if name and _room_of(name, site) is None:
        raise DestinationError(
            f"{one_line(name, 60)}: no room has this name, and the robot does not recognise this "
            "kind of room; give a room this name first"
        )
    return name


def _room_of(text: str, site: Site) -> RoomTarget | None:
    """Return the room that a normalised name means, or None."""
    target = room_target(text)
    if target.which != "called":
        return target
    kind, found = kind_of_room(text), _ROOM_NUMBER.fullmatch(text)
    by_number = found is not None and number_words.number([found["n"]]) is not None
    by_person = site.room_name(text) or any(
        kind and kind_of_room(room.name) == kind for room in site.room_names
    )
    return target if by_number or by_person or kind in RECOGNISED_KINDS else None


def has_own_end(destination: Destination | None) -> bool:
    """Return True if a destination ends by itself, so that the limits of a search do not apply.

    An exploration and a tour end when nothing is left, or after their time. A wait ends after its
    time, or when a person says so.
    """
    return isinstance(destination, (ExploreTarget, EveryRoomTarget, EveryObjectTarget, WaitTarget))


def with_caller(site: Site, pose: SE2 | None) -> Site:
    """Return the site with the caller's pose among its places, if it is known."""
    return site if pose is None else site.with_item(Place(CALLER, pose))


def describe_destination(name: str, destination: Destination) -> str:
    """Return a destination in plain English, as the object of "reach"."""
    if isinstance(destination, ExploreTarget):
        room = f" the {destination.room}" if destination.room else ""
        time = "" if destination.limit_s is None else f" for {shown_s(destination.limit_s)}"
        return f"the end of exploring{room}{time}"
    if isinstance(destination, WaitTarget):
        of = " of" if destination.seconds is not None else ""
        return f"the end of a wait{of} {destination.shown.removesuffix(' to go on')}"
    if isinstance(destination, CheckTarget):
        room = f" in the {destination.room}" if destination.room else ""
        return f"an answer about the {destination.name}{room}"
    if isinstance(destination, RoomTarget) and destination.which != "called":
        if destination.which == "with":
            return f"the room with the {destination.name}"
        return f"the {names.normalise(name)}"
    if isinstance(destination, (EveryRoomTarget, EveryObjectTarget)):
        return name
    if isinstance(destination, FailureTarget):
        return f"the point where the robot gives up {destination.target}"
    special = {
        START: "the start", HERE: "the place where this mission begins", CALLER: "the caller",
    }  # fmt: skip
    return special.get(name, f'"{name}"')


def destinations_json(destinations: Mapping[str, Destination]) -> dict[str, Any]:
    """Return destinations as JSON."""
    return _DESTINATIONS.dump_python(dict(destinations), mode="json")


def destinations_of_json(data: Any) -> dict[str, Destination]:
    """Return destinations from JSON."""
    return _DESTINATIONS.validate_python(data)


def duration_s(text: str) -> float:
    """Return the seconds of a text such as `30 s`, `1.5 min` or `two hours`.

    Raises:
        DestinationError: there is no number, or the time is too long.
    """
    *number, unit = text.split()
    unit_s = _UNITS_S.get(unit if unit == "s" else unit.rstrip("s"), 0)
    count: float | None = number_words.number(number) if number else None
    if count is None and re.fullmatch(r"\d{1,6}\.\d{1,3}", " ".join(number)):
        count = float(number[0])
    if count is None or not 0 < count * unit_s <= LONGEST_S:
        raise DestinationError(
            f"{one_line(text, 60)}: expected a time above 0 s and up to {LONGEST_S / 3600:g} h, "
            'as in "30 s" or "10 min"'
        )
    return float(count * unit_s)
