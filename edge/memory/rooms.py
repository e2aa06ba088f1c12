"""Rooms of the map: their kinds by the objects seen in them, names from people, and questions.

The prior's table says how often each class is in each kind of room. A class is a name of objects
that has a row in this table, such as "bed".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from edge.host.checkpoint import Arrays, check_arrays
from edge.mapping.regions import RegionMap
from edge.memory.objects import known_objects
from edge.memory.room_kinds import kind_of_room
from edge.memory.room_shapes import NO_SURVEY, LostRoom, RoomShape, RoomSurvey
from edge.memory.site import RoomName, Site, is_same
from edge.perception.prior import rooms as kind_model
from edge.perception.prior.table import ObjectPrior, load
from edge.perception.prior.words import PriorWordIndex
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.text import one_line

FULL_WEIGHT = 0.15
"""Confidence from which an object has full weight; low, as the mean includes views from afar."""
SURE_KIND = 0.7
"""Smallest probability of a kind for a room to count as a room of this kind."""
_VOTE_M = 1.5  # distance at which an object's vote for the kind of a point has fallen to 1/e
# Largest vote of an object against a kind. The largest votes for a kind are near 1, and the
# logarithm of a very small probability would outweigh them all.
_MAX_AGAINST = 1.0
SAME_SPOT_M = 2.0
"""A room's name that is given this near to an older one replaces it."""
PERIOD_NS = 250_000_000
"""Shortest time between two updates by new objects."""
_REASONS = 2  # number of objects that an explanation names
_MAX_ROOMS = 1 << 12  # in a checkpoint


RECOGNISED_KINDS = load().kinds
"""Kinds of rooms that the robot recognises by objects; others only a person can name."""
TYPICAL = 2
"""Number of typical classes from which the kind of a room should be known."""
_TYPICAL_RATIO = 1.5
"""A class is typical of a kind of room if it is more frequent there by this factor than on average.
"""


@lru_cache(maxsize=8)
def _kind_log_ratio(table: ObjectPrior) -> np.ndarray:
    """Return log P(class in a room | kind) / P(class in a room), (kinds, classes) float64."""
    p_object_given_kind = kind_model.object_given_room(table)
    return np.log(p_object_given_kind / (kind_model.room_prior(table) @ p_object_given_kind))


@cache
def typical_classes(kind: str) -> frozenset[str]:
    """Return the classes of the prior's table that are clearly more frequent in a kind of room."""
    table = load()
    ratio = np.exp(_kind_log_ratio(table)[table.kinds.index(kind)])
    return frozenset(table.classes[at] for at in np.flatnonzero(ratio >= _TYPICAL_RATIO))


class SeenObjects(NamedTuple):
    """Objects that were seen, as parallel arrays.

    Attributes:
        xyz_m: (n, 3) float32 in `map`.
        row: (n,) int32, row of the prior's table; -1 if the object is not in it.
        weight: (n,) float32 in [0, 1], confidence in the object over `FULL_WEIGHT`.
    """

    xyz_m: np.ndarray
    row: np.ndarray
    weight: np.ndarray


class SeenObjectIndex:
    """Rows of the prior's table for the tracked objects."""

    def __init__(self, words: PriorWordIndex) -> None:
        self._words = words
        self._row = np.zeros(0, np.int32)

    def of(self, objects: TrackedObjects) -> SeenObjects:
        """Return the objects; `xyz_m` is a view."""
        n = objects.n
        if len(objects.words) != len(self._row):
            self._row = np.array([self._words.row(word) for word in objects.words], np.int32)
        weight = np.minimum(objects.confidence[:n] / np.float32(FULL_WEIGHT), np.float32(1.0))
        return SeenObjects(objects.xyz_m[:n], self._row[objects.word[:n]], weight)


def objects_by_region(regions: RegionMap, objects: SeenObjects, n_classes: int) -> np.ndarray:
    """Return the confidence that each class is in each region, (n + 1, classes) float32."""
    confidence = np.zeros((regions.n + 1, n_classes), np.float32)
    region = regions.at(objects.xyz_m)
    counts = (region > 0) & (objects.row >= 0)
    np.maximum.at(confidence, (region[counts], objects.row[counts]), objects.weight[counts])
    return confidence


def kinds_by_region(table: ObjectPrior, border: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Return P(kind of room | objects seen) of each region, (n + 1, kinds) float64."""
    adjacent = kind_model.adjacent_regions(border, held)
    return kind_model.room_posterior_at(table, held, held[adjacent])


@dataclass(frozen=True, slots=True, eq=False)
class MappedRoom(RoomShape):
    """A room of the map: its shape, and what the service knows about it.

    Attributes:
        names: names that people gave, the newest last. An open-plan room may have several.
        kinds: kinds of the room that are certain enough. An open-plan room may be kitchen and
            living room.
        chance: probability of each kind of the prior's table; 1 for a kind that a person named.
        held: (classes,) float32, confidence that each class of the prior's table is in the room.
        is_visited: True if the robot was inside.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    chance: dict[str, float]
    held: np.ndarray
    is_visited: bool

    @property
    def name(self) -> str:
        """The newest name that a person gave; "" for none."""
        return self.names[-1] if self.names else ""

    def is_called(self, name: str) -> bool:
        """Return True if a person gave the room this name."""
        return any(is_same(own, name) for own in self.names)

    @property
    def title(self) -> str:
        """Name of the room; without a name its kinds; without kinds its number."""
        return self.name or " and ".join(self.kinds) or f"room {self.id}"

    @property
    def phrase(self) -> str:
        """Title of the room in a sentence: "the kitchen", or "room 3"."""
        return f"the {self.title}" if self.name or self.kinds else self.title

    @property
    def is_named(self) -> bool:
        """True if a person's name says what kind of room it is."""
        return any(kind_of_room(name) is not None for name in self.names)

    @property
    def reason(self) -> str:
        """Why the room has its kinds, for people; "" without a reason."""
        return "named by a person" if self.is_named else _reason_text(self.kinds, self.held)

    @property
    def classes(self) -> list[str]:
        """Classes of the prior's table that were seen in the room."""
        return [load().classes[at] for at in np.flatnonzero(self.held)]

    def closed_by(self, site: Site) -> str:
        """Return the name of a zone if zones close all points to stand at; else ""."""
        closed = [site.closed_by(x_m, y_m) for x_m, y_m in self.points_m.tolist()]
        return closed[0] if all(closed) else ""

    def to_json(self) -> dict[str, Any]:
        """Return the room as a JSON-ready dict."""
        return {
            "id": self.id, "name": self.name, "kinds": list(self.kinds), "reason": self.reason,
            "chance": {kind: round(p, 3) for kind, p in self.chance.items()},
            "polygon": np.round(self.polygon_m, 2).tolist(), "area_m2": round(self.area_m2, 1),
            "xy": [round(v, 2) for v in self.xy_m], "visited": self.is_visited,
            "doors": [
                {"room": door.room, "xy": [round(v, 2) for v in door.xy_m],
                 "width_m": round(door.width_m, 1)}
                for door in self.doors
            ],
        }  # fmt: skip


class RoomMemory:
    """The owner of the rooms; for the loop's thread.

    Attributes:
        version: number that grows when anything about the rooms changes.
        site: names that people gave; set by `set_site`.
    """

    def __init__(self, table: ObjectPrior, words: PriorWordIndex) -> None:
        self.survey: RoomSurvey = NO_SURVEY
        self.version = 0
        self.rooms: tuple[MappedRoom, ...] = ()
        self._table = table
        self._index = SeenObjectIndex(words)
        # (regions + 1, kinds), P(kind of room | objects seen) of each region at the last update.
        self._belief = kind_model.room_prior(table)[None]
        self._objects = SeenObjects(
            np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32)
        )
        self._votes: dict[tuple[int, str], np.ndarray] = {}  # of this `version`
        self.site = Site()
        self._visited: set[int] = set()
        self._generation = -1  # `TrackedObjects.generation` of the last update
        self._updated_ns = 0
        self._is_due = False

    # -- in each tick -----------------------------------------------------------------------

    def on_survey(self, survey: RoomSurvey) -> None:
        """Use the shapes of a new survey."""
        self.survey, self._is_due = survey, True

    def on_pose(self, x_m: float, y_m: float) -> None:
        """Mark the room as visited that the robot is in."""
        if (room := self.entered_room(x_m, y_m)) and room not in self._visited:
            self._visited.add(room)
            self._is_due = True

    def update(self, objects: TrackedObjects, now_ns: int) -> None:
        """Update kinds and names if something changed.

        New objects alone cause an update at most every `PERIOD_NS`.
        """
        period_over = not 0 <= now_ns - self._updated_ns < PERIOD_NS
        if not self._is_due and (objects.generation == self._generation or not period_over):
            return
        self._is_due, self._generation, self._updated_ns = False, objects.generation, now_ns
        self.version += 1
        self._votes.clear()
        regions, seen = self.survey.regions, self._index.of(objects)
        held = objects_by_region(regions, seen, len(self._table.classes))
        self._objects = seen._replace(xyz_m=seen.xyz_m.copy())
        self._belief = kinds_by_region(self._table, regions.border, held)
        shapes, named = self.survey.shapes, _names_by_room(self.survey, self.site.room_names)
        region = [shape.region for shape in shapes]
        area_m2 = np.array([shape.area_m2 for shape in shapes])
        chance = kind_model.included_kinds(self._table, held[region], area_m2)
        self.rooms = tuple(
            _mapped_room(
                shape,
                held[shape.region],
                dict(zip(self._table.kinds, row.tolist(), strict=True)),
                named.get(shape.id, ()),
                shape.id in self._visited,
            )
            for shape, row in zip(shapes, chance, strict=True)
        )

    def set_site(self, site: Site) -> None:
        """Use the names that people gave."""
        self.site, self._is_due = site, True

    # -- questions --------------------------------------------------------------------------

    def room(self, room_id: int) -> MappedRoom | None:
        """Return the room with this id, or None."""
        return next((room for room in self.rooms if room.id == room_id), None)

    def room_at(self, x_m: float, y_m: float) -> MappedRoom | None:
        """Return the room of a point, or of an object at a wall; None if there is no room."""
        region = int(self.survey.regions.at(np.array([[x_m, y_m]], np.float32))[0])
        return self.room(int(self.survey.ids[region])) if region else None

    def room_phrase(self, x_m: float, y_m: float) -> str:
        """Return the room of a point in words, such as "in the kitchen"; "" if there is none."""
        room = self.room_at(x_m, y_m)
        return "" if room is None else f"in {room.phrase}"

    def title_at(self, x_m: float, y_m: float) -> str:
        """Return the title of the room of a point, such as "kitchen"; "" if there is none."""
        room = self.room_at(x_m, y_m)
        return "" if room is None else room.title

    def is_in(self, name: str, x_m: float, y_m: float) -> bool:
        """Return True if a point, or an object at a wall, is in a room that the name may mean."""
        room = self.room_at(x_m, y_m)
        return room is not None and any(other.id == room.id for other in self.matching(name))

    def entered_room(self, x_m: float, y_m: float) -> int:
        """Return the id of the room that a robot at a point is inside of; 0 if it is in none."""
        room_id, depth_m = self.survey.depth_at(x_m, y_m)
        shape = next((each for each in self.survey.shapes if each.id == room_id), None)
        return room_id if shape is not None and depth_m >= shape.inside_m else 0

    def find(self, name: str) -> list[MappedRoom]:
        """Return the rooms that a name means: by a person's name, else by number, else by kind."""
        named = [room for room in self.rooms if room.is_called(name)]
        numbered = [room for room in self.rooms if is_same(f"room {room.id}", name)]
        kind = kind_of_room(name)
        return named or numbered or [room for room in self.rooms if kind in room.kinds]

    def matching(self, name: str) -> list[MappedRoom]:
        """Return all rooms that a name may mean: by a person's name, by number and by kind."""
        kind = kind_of_room(name)
        return [
            room
            for room in self.rooms
            if room.is_called(name) or is_same(f"room {room.id}", name) or kind in room.kinds
        ]

    def with_object(self, name: str, objects: TrackedObjects, min_hits: int) -> list[MappedRoom]:
        """Return the rooms in which an object was seen, the most confident sighting first."""
        found = [self.room_at(*obj.xyz_m[:2]) for obj in known_objects(objects, 0, min_hits, name)]
        return list({room.id: room for room in found if room is not None}.values())

    def kind_ratio(self, kind: str, xy_m: np.ndarray) -> np.ndarray:
        """Return P(kind of room | objects seen) / P(kind of room) for the room of each place.

        Args:
            kind: a kind of room of the prior's table.
            xy_m: (n, 2) float32 in `map`.

        Returns:
            (n,) float64; see `edge.perception.prior.rooms.room_posterior_at`.
        """
        column = self._table.kinds.index(kind)
        belief, average = self._belief[:, column], kind_model.room_prior(self._table)[column]
        if len(belief) != self.survey.regions.n + 1:  # a new survey came after the last update
            return np.ones(len(xy_m))
        return belief[self.survey.regions.at(xy_m)] / average

    def evidence(self, room: MappedRoom, kind: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the objects in a room, and how much each speaks for a kind or against it.

        Objects that speak more for another kind of the room count against it: in an open-plan room,
        the kitchen is where its objects are.

        Returns:
            (n, 2) float32, places in `map`; and (n,) float64, above 0: it speaks for the kind.
        """
        objects, column = self._objects, self._table.kinds.index(kind)
        is_inside = self.survey.ids[self.survey.regions.at(objects.xyz_m)] == room.id
        inside = np.flatnonzero(is_inside & (objects.row >= 0))
        others = [self._table.kinds.index(k) for k in room.kinds if k in self._table.kinds]
        log_ratio = _kind_log_ratio(self._table)
        rows = [log_ratio[other] for other in others if other != column]
        other_kinds = np.maximum(0.0, np.max(rows, axis=0)) if rows else 0.0
        ratio = np.maximum(log_ratio[column] - other_kinds, -_MAX_AGAINST)
        weights = ratio[objects.row[inside]] * objects.weight[inside]
        return objects.xyz_m[inside, :2], weights.astype(np.float64)

    def votes(self, room: MappedRoom, kind: str) -> np.ndarray:
        """Return how much the objects near each of a room's points speak for a kind, (j,) float64.

        See `evidence`. The result is computed once for each `version`: each tick asks for it.
        """
        if (room.id, kind) not in self._votes:
            xy_m, weights = self.evidence(room, kind)
            # (j, n), from each of the room's points to each object.
            distance_m = np.hypot(*(room.points_m[:, None] - xy_m).transpose(2, 0, 1))
            self._votes[room.id, kind] = np.exp(-distance_m / _VOTE_M) @ weights
        return self._votes[room.id, kind]

    # -- frames and checkpoints ----------------------------------------------------------------

    def on_pose_jump(self) -> None:
        """Forget all rooms, because the frame has changed. New rooms get new ids."""
        self.survey = NO_SURVEY._replace(next_id=self.survey.next_id)
        self._visited.clear()
        self.rooms, self._is_due = (), True
        self.version += 1
        self._votes.clear()

    def state_dict(self) -> Arrays:
        """Return the ids of the rooms, each with a point inside; the map gives the shapes again."""
        s = self.survey
        rooms = [*s.lost, *(LostRoom(shape.id, *shape.xy_m) for shape in s.shapes)]
        return {
            "id": np.array([room.id for room in rooms], np.int64),
            "xy_m": np.array([(room.x_m, room.y_m) for room in rooms], np.float64).reshape(-1, 2),
            "visited": np.array([room.id in self._visited for room in rooms], np.bool_),
            "next_id": np.array(s.next_id),
        }

    def load_state_dict(self, state: Arrays) -> None:
        """Restore a `state_dict`; older checkpoints have none.

        Raises:
            ValueError: the state is invalid.
        """
        if not state:
            return
        rows: dict[tuple[str, ...], int] = {("id", "xy_m", "visited"): _MAX_ROOMS}
        check_arrays(state, self.state_dict(), rows, {}, ("id",))
        lost = zip(state["id"].tolist(), state["xy_m"].tolist(), strict=True)
        next_id = max(int(state["next_id"]), 1 + max(state["id"].tolist(), default=0))
        self.on_survey(
            NO_SURVEY._replace(next_id=next_id, lost=tuple(LostRoom(i, *at) for i, at in lost))
        )
        self._visited = set(state["id"][state["visited"]].tolist())


def _names_by_room(
    survey: RoomSurvey, room_names: Sequence[RoomName]
) -> dict[int, tuple[str, ...]]:
    """Return the names of each room that has some, newest last.

    A name replaces one that was given at about the same place; an open-plan room may have several.
    """
    named: dict[int, list[RoomName]] = {}
    if room_names:
        at = survey.regions.at(np.array([one.xy_m for one in room_names], np.float32))
        for room_name, region in zip(room_names, at.tolist(), strict=True):
            if room_id := int(survey.ids[region]):
                kept = [
                    one
                    for one in named.get(room_id, ())
                    if math.dist(one.xy_m, room_name.xy_m) > SAME_SPOT_M
                ]
                named[room_id] = [*kept, room_name]
    return {room_id: tuple(one.name for one in found) for room_id, found in named.items()}


def _mapped_room(
    shape: RoomShape,
    held: np.ndarray,
    by_kind: dict[str, float],
    names: tuple[str, ...],
    is_visited: bool,
) -> MappedRoom:
    """Return a room with its kinds, by people's names or by the chance of each kind."""
    found = tuple(kind for kind, p in by_kind.items() if p >= SURE_KIND)
    if by_person := tuple(dict.fromkeys(filter(None, map(kind_of_room, names)))):
        found = by_person
        by_kind = {**dict.fromkeys(by_kind, 0.0), **dict.fromkeys(by_person, 1.0)}
    of_shape = {field.name: getattr(shape, field.name) for field in fields(shape)}
    return MappedRoom(
        **of_shape, names=names, kinds=found, chance=by_kind, held=held, is_visited=is_visited
    )


def _reason_text(found: tuple[str, ...], held: np.ndarray) -> str:
    """Return the objects that speak most for some kinds, in words; "" if there are none."""
    table, named = load(), []
    log_ratio = _kind_log_ratio(table)
    for kind in found:
        weights = held * log_ratio[table.kinds.index(kind)]
        best = [at for at in np.argsort(-weights)[:_REASONS].tolist() if weights[at] > 0.0]
        named += [table.classes[at] for at in best]
    return one_line(f"{' and '.join(dict.fromkeys(named))} seen") if named else ""
