"""Tours: pursuits that go into each room, or to each object of a name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.loop.behaviours.pursuits import Pursuit, objects_found
from edge.loop.behaviours.room_pursuits import ExploreRoomPursuit, RoomVisit, SearchRoomPursuit
from edge.loop.behaviours.room_targets import is_closed
from edge.loop.goals.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.memory import MappedRoom, parse_description
from edge.mission.destinations import EveryObjectTarget, EveryRoomTarget
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.text import one_line
from edge.types import Goal, Instance

_TRIES = 2  # failed goals in a room after which a tour leaves it out
_TRIED_M = 0.8  # another object this near to a place that was tried is taken for the same


class EveryRoomPursuit(ExploreRoomPursuit):
    """Tour of all rooms, or of all of a kind: into each one, to its frontiers, and a look around.

    The nearest room comes first. While none is left, the robot explores to find more.
    """

    def __init__(
        self,
        destination: EveryRoomTarget,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        super().__init__(destination, mission, semantic_map, goals)
        self._room_name = destination.room or "room"
        self._wanted = f"another {self._room_name}"
        # A point in each room that is done, or that it cannot get into: ids of rooms may change.
        self._done_m: list[tuple[float, float]] = []
        self._missed_m: list[tuple[float, float]] = []

    def check_progress(self, context: PolicyInput, images: int) -> None:
        room = self._map.rooms.room(self._visit.chosen_id)
        if room is not None and self._chooser.place_failures >= _TRIES:
            self._missed_m.append(room.xy_m)
            self._next_room()
        if self._inside is not None:
            self._phrase = self._inside.phrase
        elif self._chooser.search.exhausted and not (self._visit.chosen_id or self._known_rooms()):
            self.finish(context.now_ns)  # retries and second looks find no other room
            return
        super().check_progress(context, images)

    def end(self, now_ns: int) -> None:
        """End the visit of one room: its frontiers are explored."""
        if self._inside is not None:
            self._done_m.append(self._inside.xy_m)
        self._next_room()

    def finish(self, now_ns: int) -> None:
        """End the tour: no room is left. If there was none, try the one most likely of the kind."""
        guess = self._most_likely(self._kind) if self._kind and not self._done_m else None
        if guess is not None and guess.id != self._visit.chosen_id:
            tried = self._holds(guess, self._missed_m) or is_closed(guess, self._map, self._kind)
            if not tried:
                self._visit.chosen_id, self._visit.is_final = guess.id, True
                return
        of_kind = self._rooms_of_kind()
        visited = [room for room in self._map.rooms.rooms if self._holds(room, self._done_m)]
        done = [room for room in visited if room in of_kind] or visited
        missed = [room.title for room in of_kind if room not in done]
        end = f"; did not get into: {', '.join(missed)}" if missed else ""
        if not done:
            text = f"explored all reachable space, found no {self._room_name}{end}"
            self._mission.abandon_target(one_line(text), now_ns)
            return
        titles = [room.title + " (probably one)" * (room not in of_kind) for room in done]
        plural = "" if len(done) == 1 else "s"
        text = one_line(f"was in {len(done)} {self._room_name}{plural}: {', '.join(titles)}{end}")
        self._mission.on_reached(text, now_ns, f"{text}; {objects_found(self._map)}")

    def _next_room(self) -> None:
        """Start on the next room, with a new search."""
        self._inside, self._visit = None, RoomVisit()
        self._chooser.begin_target(self._mission.target)

    def _known_rooms(self) -> list[MappedRoom]:
        """Return the rooms that are left."""
        return [
            room
            for room in self._rooms_of_kind()
            if not self._holds(room, self._done_m + self._missed_m)
            and np.isfinite(self._distance_m(room))
            and not is_closed(room, self._map, self._kind)
        ]

    def _rooms_of_kind(self) -> Sequence[MappedRoom]:
        rooms, kind = self._map.rooms, self._destination.name
        return rooms.matching(kind) if kind else rooms.rooms

    def _holds(self, room: MappedRoom, points_m: Sequence[tuple[float, float]]) -> bool:
        """Return True if one of the points is in a room."""
        return bool(self._is_in(np.array(points_m, np.float32).reshape(-1, 2), room).any())


class TriedPlaces:
    """Places where an object seemed to be, and was not confirmed from within `confirm_range_m`.

    Without them, a count goes on for minutes to what the detector sees there again and again.
    """

    def __init__(self, semantic_map: SemanticMap) -> None:
        self._map = semantic_map
        self._goal: Goal | None = None  # of the tick before
        self._tried_m: list[tuple[float, float]] = []

    def note(self, goal: Goal | None, pose: SE2) -> None:
        """Note the goal of a tick: the place of the goal before may have been tried in vain."""
        last, self._goal = self._goal, goal
        if last is None or last.kind != "instance":
            return
        if goal is not None and goal.candidate_id == last.candidate_id:
            return
        instance = self._map.tracker.get(last.candidate_id)
        near_m = self._map.config.perception.confirm_range_m
        is_near = pose.distance_to(*last.candidate_xy_m) <= near_m
        if is_near and (instance is None or not instance.is_confirmed):
            self._tried_m.append(last.candidate_xy_m)

    def without(self, instances: Sequence[Instance]) -> list[Instance]:
        """Return the objects that are confirmed, or at no such place."""
        return [
            one
            for one in instances
            if one.is_confirmed or all(one.distance_m(*xy_m) > _TRIED_M for xy_m in self._tried_m)
        ]


class EveryObjectPursuit(Pursuit[EveryObjectTarget]):
    """Pursuit of all objects of a name: go to each one, and explore until nothing is left.

    It ends then: retries would go on for minutes, to objects that are out of reach or doubtful.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._tried = TriedPlaces(self._map)

    def target_objects(self) -> Sequence[Instance]:
        return self._tried.without(super().target_objects())

    def check_progress(self, context: PolicyInput, images: int) -> None:
        self._tried.note(self._goals.goal, context.pose)
        self._mission.activity = f"looking for {self._mission.target}"
        if self._chooser.search.exhausted:
            self.finish(context.now_ns)
        else:
            super().check_progress(context, images)

    def finish(self, now_ns: int) -> None:
        end_with_count(self._mission, self._map, self._target_label, list, now_ns)

    def _mind_limits(self, now_ns: int) -> None:
        """Do nothing: such a search has no limits."""


class EveryObjectInRoomPursuit(SearchRoomPursuit):
    """Pursuit of all objects of a name in one room: it ends as soon as the room is explored."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._tried = TriedPlaces(self._map)

    def target_objects(self) -> Sequence[Instance]:
        return self._tried.without(super().target_objects())

    def check_progress(self, context: PolicyInput, images: int) -> None:
        self._tried.note(self._goals.goal, context.pose)
        super().check_progress(context, images)

    def end(self, now_ns: int) -> None:
        end_with_count(self._mission, self._map, self._target_label, self._in_room, now_ns)


def end_with_count(
    mission: MissionRun,
    semantic_map: SemanticMap,
    label: str,
    counted: Callable[[Sequence[Instance]], Sequence[Instance]],
    now_ns: int,
) -> None:
    """End the search for all objects of a name with their number and places.

    None found is an answer, too: the mission goes on.

    Args:
        mission: the mission, in which it is the target.
        semantic_map: the objects and the rooms.
        label: the target without its room, such as "every chair".
        counted: returns those of some objects that count.
        now_ns: loop time.
    """
    name = label.removeprefix("every ")  # or description of one such object
    described = parse_description(name)
    noun = name if described is None else described.noun
    tracker, rooms = semantic_map.tracker, semantic_map.rooms
    found = [one for one in counted(tracker.of(name)) if one.state == "reached"]
    missed = len(counted(tracker.of(label, only_confirmed=True, with_contested=False)))
    known = counted(tracker.of(name, only_confirmed=True, with_contested=False))
    near = sum(one.state != "reached" for one in known) - missed
    text = f"found {len(found) or 'no'} {noun if len(found) < 2 else names.plural(noun)}"
    others = [f"did not get to {missed} more"] if missed else []
    others += [f"{near} more may be parts of these"] if near > 0 else []
    text += f" ({'; '.join(others)})" if others else ""
    at_m = [one.center_m[:2].tolist() for one in found]
    places = [f"{rooms.room_phrase(x, y)} at ({x:.1f}, {y:.1f})".lstrip() for x, y in at_m]
    text = one_line(": ".join(filter(None, (text, ", ".join(places)))), 1000)
    mission.on_reached(text, now_ns, text)
