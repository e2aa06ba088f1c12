"""Pursuits: one class for each kind of target says how the robot goes there and when it is done.

`SearchBehaviour` makes a pursuit for each active target and calls it in each tick. A target is a
*thing*, such as "chair", or a destination: a place, a room, an exploration, a wait or a check.

`PURSUITS` has one class for each kind of destination. Another kind needs a class and a line there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from edge import names
from edge.config import PolicySearch
from edge.loop.behaviours.room_targets import RoomKindPrior, is_closed, rooms_of
from edge.loop.goal import POINT_SNAP_M, SAME_POINT_M, GoalTracker
from edge.loop.search_state import ProbableObject
from edge.loop.semantic_map import SemanticMap
from edge.memory import (
    RECOGNISED_KINDS,
    MappedRoom,
    RoomSurvey,
    describe_location,
    kind_of_room,
    known_objects,
)
from edge.mission.destinations import (
    CheckTarget,
    Destination,
    ExploreTarget,
    PlaceTarget,
    RoomTarget,
    WaitTarget,
    room_target,
    shown_s,
)
from edge.mission.run import PROBABLY, MissionRun
from edge.policies.base import FRONTIER, PolicyInput
from edge.policies.search import SearchPolicy
from edge.policies.select import rank_candidates
from edge.text import one_line
from edge.types import Goal, Instance

_MAX_NAMES = 12  # object names in the report of an exploration
# `RoomMemory.votes` says how much the objects near a point speak for a kind of room. A point needs
# this share of the range from the lowest to the highest votes to be a goal, and to stay one.
_GOOD_SHARE, _KEPT_SHARE = 0.9, 0.7
_SURVEYS = 2  # surveys after the arrival that must agree that the robot is inside
_DEEPER_M = 0.4  # length of the next move if the robot arrived, but is not inside
_AROUND_M = 3.0  # distance within which a room of a kind is explored before it counts as reached
_LAST_CHANCE = 0.2  # least probability of a kind for a room to be tried when all is explored
_ASK_S = 60.0  # time for a person to confirm a probable object
_ROOM_SNAP_M = np.array([0.5])  # for the distance to a room
DestinationType = TypeVar("DestinationType", bound="Destination | None")


class Pursuit(Generic[DestinationType]):
    """Pursuit of a thing: search for it, and go to it. Base class of the others.

    Args:
        destination: The active target; None for a thing.
        mission: The mission.
        semantic_map: The semantic map.
        goals: The goal tracker.
    """

    def __init__(
        self,
        destination: DestinationType,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        self._destination, self._mission, self._map, self._goals = (
            destination,
            mission,
            semantic_map,
            goals,
        )
        self._since_ns: int | None = None  # stamp of the first observation of the pursuit
        self._probable: ProbableObject | None = None  # the object that the robot goes back to
        self._has_path = True  # to this object
        self._asked_at_s = 0.0  # `pursued_now_s` of the mission when the robot asked about it

    @property
    def _target_label(self) -> str:
        """The thing to go to: a name, or a description by a relation."""
        return self._mission.target

    def gather(self) -> Sequence[Instance]:
        """Return the objects that are candidates for this target."""
        only_confirmed = not self._map.config.policy.instances
        # Objects that probably are another thing come last, when nothing else is left.
        doubted = self._goals.candidates_exhausted
        return self._map.tracker.of(self._target_label, only_confirmed, doubted=doubted)

    def check_progress(self, context: PolicyInput, images: int) -> None:
        """Check the goal, then the end of the target; see `Behaviour.plan`."""
        retargets_before = self._mission.retargets
        if self._since_ns is None:
            self._since_ns = context.observation.stamp_ns
        self._goals.check_progress(
            self._map.grid, context.pose, self._mission, images, context.now_ns, self._is_reached
        )
        if self._mission.retargets != retargets_before or self._mission.done:
            return
        if self._probable is not None:
            self._check_probable(self._probable, context)
        elif self._goals.exhausted:
            self.finish(context.now_ns)

    def _is_reached(self, instance: Instance) -> bool:
        """Return True if the robot, which stands next to it, has reached this object.

        A remembered object must be seen again: it may have been moved.
        """
        seen_again = self._since_ns is not None and instance.last_seen_ns >= self._since_ns
        return seen_again and self._map.tracker.confirmed(instance)

    def finish(self, now_ns: int) -> None:
        """End the target, or go back to a probable object: no candidate is left."""
        if self._mission.config.probable != "refuse":
            self._probable = self._goals.probable
        if self._probable is None:
            self._mission.abandon_target(
                self._goals.failure_reason(self._mission, self._map.grid), now_ns
            )

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return the goal of this tick; see `Behaviour.select`."""
        grid, target = self._map.grid, self._mission.target
        if self._probable is None:
            return self._goals.choose(context, grid, scores, images)
        if self._mission.question:
            self._goals.idle()
            return None
        stop_m = np.array([self._probable.stop_m])
        goal = self._goals.go_to_point(context, grid, stop_m, target, keep=True)
        self._has_path = goal is not None
        return goal

    def _check_probable(self, probable: ProbableObject, context: PolicyInput) -> None:
        """Accept the probable object when the robot is at it, or ask a person."""
        mission, goals, now_ns = self._mission, self._goals, context.now_ns
        if goals.probable is not probable:  # the frame has changed: search again
            self._probable, mission.question = None, ""
            return
        if not self._has_path:
            mission.abandon_target(goals.failure_reason(mission, self._map.grid), now_ns)
            return
        goal = goals.goal
        arrived = goals.arrived and goal is not None and goal.kind == "place"
        if not (mission.question or arrived):
            mission.activity = f"going back to what may be the {mission.target}"
            return
        text = mission.question or self._describe(probable)
        if mission.config.probable == "accept":
            goals.abandon()
            mission.on_reached(text, now_ns, text)
            return
        if not mission.question:
            mission.question, self._asked_at_s = text, mission.pursued_now_s
            mission.warn(mission.target, f"not sure: {text}", now_ns)
        goals.phase = "waiting"
        left_s = self._asked_at_s + _ASK_S - mission.pursued_now_s
        mission.activity = f"{text}; waiting for `edge mission confirm`, {_time_left(left_s)}"
        if left_s <= 0:
            mission.abandon_target(f"{text}; nobody confirmed it within {_ASK_S:g} s", now_ns)

    def _describe(self, probable: ProbableObject) -> str:
        """Return the score of an object and its possible names: "probably, 0.31: sofa or bench"."""
        shown, target = self._map.objects.read_only, self._mission.target
        near_m = self._map.config.perception.merge_m
        near = np.hypot(*(shown.xyz_m[: shown.n, :2] - probable.xy_m).T) <= near_m
        rows = sorted(np.flatnonzero(near).tolist(), key=lambda at: -shown.confidence[at])
        words = (shown.words[shown.word[at]] for at in rows)
        other = next((word for word in words if not names.is_kind_of(word, target)), None)
        is_it = target if other is None else f"{target} or {other}"
        return one_line(f"{PROBABLY}, {probable.score:.2f}: {is_it}")


class PlacePursuit(Pursuit[PlaceTarget]):
    """Pursuit of a place: go to its pose."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        place = self._mission.destinations[self._mission.target]
        assert isinstance(place, PlaceTarget)
        assert place.pose is not None  # set by `locate`
        target = self._mission.target
        return self._goals.go_to_place(context, self._map.grid, place.pose, target, images)


class ExplorePursuit(Pursuit[ExploreTarget]):
    """Exploration until no frontier is left, or for some time."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, limit_s = self._mission, self._destination.limit_s
        if limit_s is not None:
            left_s = limit_s - mission.pursued_now_s
            if left_s <= 0:
                self.finish(context.now_ns)
                return
            mission.activity = f"exploring, {_time_left(left_s)}"
        super().check_progress(context, images)

    def finish(self, now_ns: int) -> None:
        known = f"{self._map.grid.known_m2:.0f} m² are known"
        self._mission.on_reached(known, now_ns, f"{known}, {_objects_found(self._map)}")


class WaitPursuit(Pursuit[WaitTarget]):
    """Wait where the robot is."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, seconds = self._mission, self._destination.seconds
        self._goals.phase = "waiting"
        if seconds is None:
            mission.activity = "waiting until told to go on"
            return
        left_s = seconds - mission.pursued_now_s
        mission.activity = f"waiting, {_time_left(left_s)}"
        if left_s <= 0:
            mission.on_reached(f"waited {shown_s(seconds)}", context.now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        self._goals.idle()
        return None


class CheckAnswer:
    """Answers a check: yes for a thing that is confirmed and seen during the pursuit, else no.

    Args:
        check: The check.
        mission: The mission.
        semantic_map: The semantic map.
    """

    def __init__(self, check: CheckTarget, mission: MissionRun, semantic_map: SemanticMap) -> None:
        self.label = check.name
        self._room = f"in the {check.room}" if check.room else ""
        self._mission, self._map = mission, semantic_map
        self._since_ns: int | None = None  # stamp of the first observation of the pursuit
        self._known_before = ""  # text about the thing from earlier sightings

    def new_detections(self, context: PolicyInput) -> list[Instance]:
        """Return the confirmed objects that were detected since the first call."""
        if self._since_ns is None:
            self._since_ns = context.observation.stamp_ns
            self._known_before = self._remembered(context)
        confirmed = self._map.tracker.of(self.label, only_confirmed=True)
        return [one for one in confirmed if one.last_seen_ns >= self._since_ns]

    def answer_yes(self, seen: Sequence[Instance], context: PolicyInput) -> None:
        """Answer that these objects are there."""
        pose = context.pose
        at = min(seen, key=lambda one: one.distance_m(pose.x_m, pose.y_m))
        x_m, y_m, _ = at.center_m.tolist()
        others = f"; {len(seen)} in all" if len(seen) > 1 else ""
        where = f"at ({x_m:.1f}, {y_m:.1f}), {at.distance_m(pose.x_m, pose.y_m):.1f} m away{others}"
        room = self._map.rooms.room_phrase(x_m, y_m) or self._room
        answer = " ".join(filter(None, ("yes, there is a", self.label, room, where)))
        self._mission.on_reached(answer, context.now_ns, answer)

    def answer_no(self, reason: str, now_ns: int) -> None:
        """Answer that there is none."""
        before = f"; seen before: {self._known_before}" if self._known_before else ""
        none = " ".join(filter(None, ("no, there is no", self.label, self._room)))
        answer = f"{none}: {reason}{before}"
        self._mission.on_reached(answer, now_ns, answer)

    def _remembered(self, context: PolicyInput) -> str:
        """Return where and when the thing was seen before, for people; "" if never."""
        shown, least = self._map.objects.read_only, self._map.config.perception.min_hits
        found = known_objects(shown, context.observation.stamp_ns, least, self.label)[:1]
        if not found:
            return ""
        return describe_location(self.label, found, context.pose, True, self._map.rooms.room_phrase)

    def time_is_over(self, now_ns: int) -> bool:
        """Answer no and return True if the search limit is over."""
        limit_s = self._mission.config.search_limit_s
        if limit_s is None or self._mission.pursued_now_s <= limit_s:
            return False
        self.answer_no(f"not found within {shown_s(limit_s)}", now_ns)
        return True


class CheckPursuit(Pursuit[CheckTarget]):
    """Pursuit that checks if a thing is there: first where it was seen before, then everywhere.

    The target counts as reached with either answer.
    """

    def __init__(
        self,
        destination: CheckTarget,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        super().__init__(destination, mission, semantic_map, goals)
        self._answer = CheckAnswer(destination, mission, semantic_map)

    @property
    def _target_label(self) -> str:
        return self._answer.label

    def check_progress(self, context: PolicyInput, images: int) -> None:
        answer = self._answer
        self._mission.activity = f"checking for the {answer.label}"
        if seen := answer.new_detections(context):
            answer.answer_yes(seen, context)
        elif not answer.time_is_over(context.now_ns):
            super().check_progress(context, images)

    def finish(self, now_ns: int) -> None:
        self._answer.answer_no(self._goals.failure_reason(self._mission, self._map.grid), now_ns)

    def _is_reached(self, instance: Instance) -> bool:
        """Return False: only a new detection counts, and `check_progress` handles those."""
        return False


class RoomPursuit(Pursuit[RoomTarget]):
    """Pursuit of a room: explore where it is likely; when it is known, go inside.

    The robot is inside if the map says so, whatever the controller says of its goal. The field
    `RoomTarget.which` says how the target names the room: `called` ("the kitchen"), `largest`,
    `next` (the nearest unvisited one), or `with` ("the room with a sofa").
    """

    _chosen_id = 0  # id of the room to go to; 0: none
    _exploring_id = 0  # id of the room that is explored around `_arrived_m`; 0: none
    _explored_id = 0  # id of the room whose exploration is complete; 0: none
    _arrived_m = np.zeros(2, np.float32)  # where the robot came into the room
    # The likeliest room that the target may mean, if zones close all such rooms.
    _closed_room: MappedRoom | None = None
    _is_final = False  # True if all is explored: the choice stays
    _surveyed: RoomSurvey | None = None  # the newest survey that agreed
    _agreed = 0  # number of surveys since the arrival that agree

    def gather(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, room = self._mission, self._choose(context)
        if room is None and self._closed_room is not None and self._kind is None:
            self.finish(context.now_ns)
            return
        if room is None and self._may_guess():
            self.finish(context.now_ns)  # retries and second looks would lead elsewhere
            return
        if room is None:
            mission.activity = "exploring to find it"
            super().check_progress(context, images)
            return
        number = f"room {room.id}"
        name = number if room.title == number else f"{room.title}, {number}"
        why = one_line(f"the {name}" + (f": {room.reason}" if room.reason else ""))
        if self._is_final and self._kind is not None:
            why = f"room {room.id}, the most likely {self._kind}"
        if self._is_inside(room, context):
            self._goals.abandon()
            self.arrive(f"inside {why}", context.now_ns)
            return
        mission.activity = f"going to {why}"
        super().check_progress(context, images)

    def arrive(self, evidence: str, now_ns: int) -> None:
        """Handle the arrival inside the room."""
        self._mission.on_reached(evidence, now_ns)

    def finish(self, now_ns: int) -> None:
        room, kind = self._map.rooms.room(self._chosen_id), self._kind
        if room is not None:
            pass  # this room was chosen before, and there is no path to it
        elif self._destination.which == "largest":
            room = max(self._map.rooms.rooms, key=lambda one: one.area_m2, default=None)
        elif self._closed_room is not None:
            room = self._closed_room  # no other is likelier
        elif kind is not None:
            room = self._most_likely(kind)
        if room is not None and is_closed(room, self._map, kind):
            self._mission.abandon_target(f"a zone closes {room.phrase}, room {room.id}", now_ns)
        elif room is None or self._chosen_id == room.id:
            super().finish(now_ns)
        else:  # a last chance: go to this room
            self._chosen_id, self._is_final = room.id, True

    def _may_guess(self) -> bool:
        """Return True if all is explored, and a room may well be of the wanted kind."""
        if self._kind is None or not self._goals.candidates_exhausted:
            return False
        likely = self._most_likely(self._kind)
        return likely is not None and likely.chance[self._kind] >= _LAST_CHANCE

    def _most_likely(self, kind: str) -> MappedRoom | None:
        """Return the room to try when none is certain; None if nothing speaks for any."""
        known = self._map.rooms
        # Rooms with an object that speaks for the kind.
        rooms = [room for room in known.rooms if (known.evidence(room, kind)[1] > 0.0).any()]
        likely = max(rooms, key=lambda room: room.chance[kind], default=None)
        if likely is None or likely.chance[kind] >= _LAST_CHANCE:
            return likely
        votes = [float(known.votes(room, kind).max()) for room in rooms]
        return rooms[int(np.argmax(votes))] if max(votes) > 0.0 else None

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return a goal in the room, or on the way to it; while no room is known, explore."""
        target, grid, goals = self._destination, self._map.grid, self._goals
        if target.which != "with":  # no object is searched for, so the policy's scores do not apply
            prior = None if self._kind is None else RoomKindPrior(self._map.rooms, self._kind)
            scores = SearchPolicy(PolicySearch()).score(replace(context, prior=prior))
        scores = np.asarray(scores, np.float32)
        room = self._map.rooms.room(self._chosen_id)
        if room is not None and self._explore_around_arrival(room, context):
            return goals.choose(context, grid, scores, images)
        if room is not None:
            points_m, old, rooms = self._stopping_points_m(room), goals.goal, self._map.rooms
            keep = old is not None and rooms.entered_room(old.pose.x_m, old.pose.y_m) == room.id
            pose = context.pose
            # The controller has arrived, but the map says that the robot is not inside: go deeper.
            if goals.arrived and rooms.entered_room(pose.x_m, pose.y_m) != room.id:
                keep = False
                away_m = np.hypot(*(points_m - np.array((pose.x_m, pose.y_m), np.float32)).T)
                points_m = points_m[away_m >= min(_DEEPER_M, float(away_m.max()))]
            goal = goals.go_to_point(context, grid, points_m, self._mission.target, keep)
            return goal or goals.explore_towards(context, grid, room.xy_m, images)
        return goals.choose(context, grid, scores, images)

    @property
    def _kind(self) -> str | None:
        """The wanted kind of room, if the robot recognises it."""
        kind = kind_of_room(self._destination.name)
        return kind if self._destination.which == "called" and kind in RECOGNISED_KINDS else None

    def _is_inside(self, room: MappedRoom, context: PolicyInput) -> bool:
        """Return True if the robot is inside.

        Before its walls are known, a room may seem to go on behind a door. So a room of a kind is
        reached only when it is explored, at a point near the objects that it was recognised by,
        and if the next surveys agree. The goal is such a point, as long as it stays.
        """
        inside = self._map.rooms.entered_room(context.pose.x_m, context.pose.y_m) == room.id
        if not inside or not self._is_found_by_kind(room):
            return inside
        goal = self._goals.goal
        if not self._goals.arrived or goal is None or goal.kind != "place":
            self._agreed = 0
        elif self._explored_id != room.id:
            self._exploring_id = room.id
            self._arrived_m = np.array((context.pose.x_m, context.pose.y_m), np.float32)
        elif self._map.rooms.survey is not self._surveyed:
            self._surveyed, self._agreed = self._map.rooms.survey, self._agreed + 1
        return self._agreed > _SURVEYS  # the first one is the survey of the arrival

    def _is_found_by_kind(self, room: MappedRoom) -> bool:
        """Return True if the room is taken for the target because of its objects, not its name."""
        return self._kind is not None and not room.is_named

    def _explore_around_arrival(self, room: MappedRoom, context: PolicyInput) -> bool:
        """Return True while a room found by its kind has frontiers near the point of arrival.

        All other frontiers are then blocked in this tick.
        """
        if self._exploring_id != room.id or not self._is_found_by_kind(room):
            return False
        self._block_outside(room)
        c, delta_m = self._map.pool.candidates, self._map.config.policy.delta_reached_m
        c.blocked[: c.n] |= np.hypot(*(c.xy_m[: c.n] - self._arrived_m).T) > _AROUND_M
        left = rank_candidates(c, c.path_m[: c.n], context.pose, delta_m)  # indices, not blocked
        if np.isfinite(c.path_m[left]).any():
            return True
        self._exploring_id, self._explored_id = 0, room.id
        return False

    def _is_in(self, xy_m: np.ndarray, room: MappedRoom) -> np.ndarray:
        """Return (n,) bool: True for points (n, 2) that are in the room."""
        survey = self._map.rooms.survey
        return survey.ids[survey.regions.at(xy_m)] == room.id

    def _block_outside(self, room: MappedRoom) -> None:
        """Block the frontiers of this tick that are not in the room."""
        c = self._map.pool.candidates
        outside = ~self._is_in(c.xy_m[: c.n], room)
        c.blocked[: c.n] |= outside & (c.kind[: c.n] == FRONTIER)

    def _stopping_points_m(self, room: MappedRoom) -> np.ndarray:
        """Return the points of a room to go to, (k, 2) float32, k > 0."""
        if not self._is_found_by_kind(room):
            return room.points_m
        assert self._kind is not None
        votes = self._map.rooms.votes(room, self._kind)
        reachable = np.isfinite(self._distances_m(room, POINT_SNAP_M))
        if not reachable.any():  # no path is known yet: take all points
            reachable[:] = True
        low, high = float(votes[reachable].min()), float(votes[reachable].max())
        share = 1.0 - (high - votes) / max(high - low, 1e-9)
        good = share >= _GOOD_SHARE
        if (goal := self._goals.goal) is not None and goal.kind == "place":
            near = (
                np.hypot(*(room.points_m - np.array(goal.candidate_xy_m, np.float32)).T)
                <= SAME_POINT_M
            )
            good |= near & (share >= _KEPT_SHARE)
        return room.points_m[reachable & good]

    def _choose(self, context: PolicyInput) -> MappedRoom | None:
        """Return the room to go to; None if none is known. A choice stays while it is possible."""
        rooms, which = self._map.rooms, self._destination.which
        kept = self._is_final or which == "next"
        if kept and (room := rooms.room(self._chosen_id)) is not None:
            return room
        known = rooms_of(self._destination, self._map)
        found = [room for room in known if not is_closed(room, self._map, self._kind)]
        self._closed_room = known[0] if known and not found else None
        if which == "next":
            # Prefer rooms with a door to the robot's own; else any other that can be reached.
            current = rooms.room_at(context.pose.x_m, context.pose.y_m)
            next_door = set() if current is None else {door.room for door in current.doors}
            found = [
                room
                for room in found
                if np.isfinite(self._distance_m(room)) and room is not current
            ]
            found = [room for room in found if room.id in next_door] or found
        chosen = next((room for room in found if room.id == self._chosen_id), None)
        if chosen is None and found:
            chosen = min(found, key=lambda room: (self._distance_m(room), room.id))
        number = 0 if chosen is None else chosen.id
        if number != self._chosen_id:
            self._chosen_id = number
            self._goals.abandon()
        return chosen

    def _distance_m(self, room: MappedRoom) -> float:
        """Return the driving distance to a room; inf if no path is known."""
        return float(self._distances_m(room, _ROOM_SNAP_M).min(initial=np.inf))

    def _distances_m(self, room: MappedRoom, snap_m: np.ndarray) -> np.ndarray:
        """Return the driving distance to each point of a room, (j,) float32; inf without a path."""
        n, path_m = len(room.points_m), np.empty(len(room.points_m), np.float32)
        self._map.grid.travel_cost.path_lengths_m(
            room.points_m, np.zeros(n, np.int8), snap_m, n, path_m
        )
        return path_m


class ExploreRoomPursuit(RoomPursuit):
    """Exploration of one room: go inside, then to its frontiers, until none is left."""

    def __init__(
        self,
        destination: ExploreTarget | CheckTarget,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        super().__init__(room_target(destination.room), mission, semantic_map, goals)
        self._name, self._activity = destination.room, "exploring"
        self._limit_s = destination.limit_s if isinstance(destination, ExploreTarget) else None
        self._inside: MappedRoom | None = None  # the room, once the robot has been inside

    def check_progress(self, context: PolicyInput, images: int) -> None:
        if self._inside is not None:
            self._inside = self._map.rooms.room(self._inside.id) or self._inside
        left_s = math.inf if self._limit_s is None else self._limit_s - self._mission.pursued_now_s
        if left_s <= 0.0:
            self.end(context.now_ns)
        elif self._inside is None:
            super().check_progress(context, images)
        else:
            left = "" if self._limit_s is None else f", {_time_left(left_s)}"
            self._mission.activity = f"{self._activity} the {self._name}{left}"
            self._explore_inside(context, images)

    def arrive(self, evidence: str, now_ns: int) -> None:
        self._inside = self._map.rooms.room(self._chosen_id)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        if self._inside is None:
            return super().select(context, scores, images)
        if self._goals.candidates_exhausted:  # retries and second looks would lead elsewhere
            self._goals.idle()
            return None
        self._block_outside(self._inside)
        return self._goals.choose(context, self._map.grid, scores, images)

    def end(self, now_ns: int) -> None:
        """End the target: the room is explored, or the time is over."""
        known = f"the {self._name} was not reached"
        if self._inside is not None:
            found = _objects_found(self._map, self._inside)
            known = f"{self._name}: {self._inside.area_m2:.0f} m² are known, {found}"
        self._mission.on_reached(known, now_ns, known)

    def _explore_inside(self, context: PolicyInput, images: int) -> None:
        """Follow the goal; end the target when no candidate in the room is left."""
        mission, retargets_before = self._mission, self._mission.retargets
        self._goals.check_progress(
            self._map.grid, context.pose, mission, images, context.now_ns, self._is_reached
        )
        if (
            mission.retargets == retargets_before
            and not mission.done
            and self._goals.candidates_exhausted
        ):
            self.end(context.now_ns)


class CheckRoomPursuit(ExploreRoomPursuit):
    """Pursuit that checks if a thing is in one room."""

    def __init__(
        self,
        destination: CheckTarget,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        super().__init__(destination, mission, semantic_map, goals)
        self._activity = f"checking for the {destination.name} in"
        self._answer = CheckAnswer(destination, mission, semantic_map)

    @property
    def _target_label(self) -> str:
        return self._answer.label

    def gather(self) -> Sequence[Instance]:
        return () if self._inside is None else self._in_room(Pursuit.gather(self), self._inside)

    def check_progress(self, context: PolicyInput, images: int) -> None:
        seen = self._answer.new_detections(context)
        found = [] if self._inside is None else self._in_room(seen, self._inside)
        if found:
            self._answer.answer_yes(found, context)
        elif not self._answer.time_is_over(context.now_ns):
            super().check_progress(context, images)

    def end(self, now_ns: int) -> None:
        self._answer.answer_no("the room is explored", now_ns)

    def _is_reached(self, instance: Instance) -> bool:
        """Return False: only a new detection counts, and `check_progress` handles those."""
        return False

    def _in_room(self, instances: Sequence[Instance], room: MappedRoom) -> list[Instance]:
        xy_m = np.array([one.center_m[:2] for one in instances], np.float32).reshape(-1, 2)
        return [
            one for one, inside in zip(instances, self._is_in(xy_m, room), strict=True) if inside
        ]


def _make_explore_pursuit(destination: ExploreTarget, *others: Any) -> Pursuit:
    pursuit_class = ExploreRoomPursuit if destination.room else ExplorePursuit
    return pursuit_class(destination, *others)


def _make_check_pursuit(destination: CheckTarget, *others: Any) -> Pursuit:
    pursuit_class = CheckRoomPursuit if destination.room else CheckPursuit
    return pursuit_class(destination, *others)


PURSUITS: dict[type | None, Callable[..., Pursuit]] = {
    None: Pursuit,
    PlaceTarget: PlacePursuit,
    ExploreTarget: _make_explore_pursuit,
    WaitTarget: WaitPursuit,
    CheckTarget: _make_check_pursuit,
    RoomTarget: RoomPursuit,
}
"""Pursuit by the class of the destination; `None` is for a thing, which has no destination."""


def _time_left(left_s: float) -> str:
    """Return a time as text: "5 min left"."""
    return f"{shown_s(math.ceil(max(0.0, left_s)))} left"


def _objects_found(semantic_map: SemanticMap, room: MappedRoom | None = None) -> str:
    """Return the names of the objects in the map, or in a room, the most frequent first."""
    objects = known_objects(
        semantic_map.objects.read_only, 0, semantic_map.config.perception.min_hits
    )
    if room is not None:
        xy_m = np.array([one.xyz_m[:2] for one in objects], np.float32).reshape(-1, 2)
        ids = semantic_map.rooms.survey.ids[semantic_map.rooms.survey.regions.at(xy_m)]
        objects = [one for one, at in zip(objects, ids.tolist(), strict=True) if at == room.id]
    numbers = Counter(one.name for one in objects).most_common()
    named = [f"{name} ({n})" if n > 1 else name for name, n in numbers[:_MAX_NAMES]]
    more = len(numbers) - len(named)
    named += [f"{more} more kinds"] if more else []
    return f"found: {', '.join(named)}" if named else "found no objects"
