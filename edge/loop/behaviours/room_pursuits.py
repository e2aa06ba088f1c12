"""Pursuits of rooms: go into a room, explore it, or check if an object is in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np

from edge.config import PolicySearch
from edge.geometry import SE2
from edge.loop.behaviours.pursuits import CheckAnswer, Pursuit, objects_found, time_left
from edge.loop.behaviours.room_targets import RoomKindPrior, is_closed, rooms_of
from edge.loop.goals.goal import GoalTracker
from edge.loop.goals.known_goals import POINT_SNAP_M, SAME_POINT_M, goal_at_point, scores_towards
from edge.loop.semantic_map import SemanticMap
from edge.memory import (
    RECOGNISED_KINDS,
    DescribedObject,
    MappedRoom,
    RoomSurvey,
    kind_of_room,
    without_room,
)
from edge.mission.destinations import (
    CheckTarget,
    EveryObjectTarget,
    EveryRoomTarget,
    ExploreTarget,
    RoomTarget,
    room_target,
)
from edge.mission.run import MissionRun
from edge.policies.base import FRONTIER, PolicyInput
from edge.policies.search import SearchPolicy
from edge.policies.select import rank_candidates
from edge.text import one_line
from edge.types import Goal, Instance

# `RoomMemory.votes` says how much the objects near a point speak for a kind of room. A point needs
# this share of the range from the lowest to the highest votes to be a goal, and to stay one.
_GOOD_SHARE, _KEPT_SHARE = 0.9, 0.7
_SURVEYS = 2  # surveys after the arrival that must agree that the robot is inside
_DEEPER_M = 0.4  # length of the next move if the robot arrived, but is not inside
_AROUND_M = 3.0  # distance within which a room of a kind is explored before it counts as reached
_LAST_CHANCE = 0.2  # least probability of a kind for a room to be tried when all is explored
_ROOM_SNAP_M = np.array([0.5])  # for the distance to a room


@dataclass(eq=False)
class RoomVisit:
    """The way to one room, and the arrival in it.

    Attributes:
        chosen_id: Id of the room to go to; 0: none.
        is_final: True if all is explored: the choice stays.
        closed_room: The likeliest room that the target may mean, if zones close all such rooms.
        exploring_id: Id of the room that is explored around `arrived_m`; 0: none.
        explored_id: Id of the room whose exploration is complete; 0: none.
        arrived_m: (2,) float32, where the robot came into the room.
        surveyed: The newest survey that agreed that the robot is inside.
        agreed: Number of surveys since the arrival that agree.
    """

    chosen_id: int = 0
    is_final: bool = False
    closed_room: MappedRoom | None = None
    exploring_id: int = 0
    explored_id: int = 0
    arrived_m: np.ndarray = field(default_factory=lambda: np.zeros(2, np.float32))
    surveyed: RoomSurvey | None = None
    agreed: int = 0


class RoomPursuit(Pursuit[RoomTarget]):
    """Pursuit of a room: explore where it is likely; when it is known, go inside.

    The robot is inside if the map says so, whatever the controller says of its goal. The field
    `RoomTarget.which` says how the target names the room: `called` ("the kitchen"), `largest`,
    `next` (the nearest unvisited one), or `with` ("the room with a sofa").
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._visit = RoomVisit()
        self._wanted = "it"  # the target, in the activity

    def target_objects(self) -> Sequence[Instance]:
        return ()

    def check_progress(self, context: PolicyInput, images: int) -> None:
        mission, room = self._mission, self._choose(context)
        if room is None and self._visit.closed_room is not None and self._kind is None:
            self.finish(context.now_ns)
            return
        if room is None and self._may_guess():
            self.finish(context.now_ns)  # retries and second looks would lead elsewhere
            return
        if room is None:
            mission.activity = f"exploring to find {self._wanted}"
            super().check_progress(context, images)
            return
        number = f"room {room.id}"
        name = number if room.title == number else f"{room.title}, {number}"
        why = one_line(f"the {name}" + (f": {room.reason}" if room.reason else ""))
        if self._visit.is_final and self._kind is not None:
            why = f"room {room.id}, the most likely {self._kind}"
        if self._is_inside(room, context):
            self._chooser.abandon()
            self.arrive(f"inside {why}", context.now_ns)
            return
        mission.activity = f"going to {why}"
        super().check_progress(context, images)

    def arrive(self, evidence: str, now_ns: int) -> None:
        """Handle the arrival inside the room."""
        self._mission.on_reached(evidence, now_ns)

    def finish(self, now_ns: int) -> None:
        room, kind = self._map.rooms.room(self._visit.chosen_id), self._kind
        if room is not None:
            pass  # this room was chosen before, and there is no path to it
        elif self._destination.which == "largest":
            room = max(self._map.rooms.rooms, key=lambda one: one.area_m2, default=None)
        elif self._visit.closed_room is not None:
            room = self._visit.closed_room  # no other is likelier
        elif kind is not None:
            room = self._most_likely(kind)
        if room is not None and is_closed(room, self._map, kind):
            self._mission.abandon_target(f"a zone closes {room.phrase}, room {room.id}", now_ns)
        elif room is None or self._visit.chosen_id == room.id:
            super().finish(now_ns)
        else:  # a last chance: go to this room
            self._visit.chosen_id, self._visit.is_final = room.id, True

    def _may_guess(self) -> bool:
        """Return True if all is explored, and a room may well be of the wanted kind."""
        if self._kind is None or not self._chooser.search.exhausted:
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
        room = self._map.rooms.room(self._visit.chosen_id)
        if room is not None and self._explore_around_arrival(room, context):
            return self._chooser.choose(context, grid, scores, images)
        if room is not None:
            points_m, old, rooms = self._stopping_points_m(room), goals.goal, self._map.rooms
            keep = old is not None and rooms.entered_room(old.pose.x_m, old.pose.y_m) == room.id
            pose = context.pose
            # The controller has arrived, but the map says that the robot is not inside: go deeper.
            if goals.arrived and rooms.entered_room(pose.x_m, pose.y_m) != room.id:
                keep = False
                away_m = np.hypot(*(points_m - np.array((pose.x_m, pose.y_m), np.float32)).T)
                points_m = points_m[away_m >= min(_DEEPER_M, float(away_m.max()))]
            goal = goal_at_point(old, context, grid, points_m, self._mission.target, keep)
            if goal is not None:
                return self._chooser.drive_to(goal, ends_on_arrival=False)
            scores = scores_towards(context, room.xy_m)
        return self._chooser.choose(context, grid, scores, images)

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
        goal, visit, survey = self._goals.goal, self._visit, self._map.rooms.survey
        if not self._goals.arrived or goal is None or goal.kind != "place":
            visit.agreed = 0
        elif visit.explored_id != room.id:
            visit.exploring_id = room.id
            visit.arrived_m = np.array((context.pose.x_m, context.pose.y_m), np.float32)
        elif survey is not visit.surveyed:
            visit.surveyed, visit.agreed = survey, visit.agreed + 1
        return visit.agreed > _SURVEYS  # the first one is the survey of the arrival

    def _is_found_by_kind(self, room: MappedRoom) -> bool:
        """Return True if the room is taken for the target because of its objects, not its name."""
        return self._kind is not None and not room.is_named

    def _explore_around_arrival(self, room: MappedRoom, context: PolicyInput) -> bool:
        """Return True while a room found by its kind has frontiers near the point of arrival.

        All other frontiers are then blocked in this tick.
        """
        if self._visit.exploring_id != room.id or not self._is_found_by_kind(room):
            return False
        self._block_outside(room)
        c, delta_m = self._map.pool.candidates, self._map.config.policy.delta_reached_m
        c.blocked[: c.n] |= np.hypot(*(c.xy_m[: c.n] - self._visit.arrived_m).T) > _AROUND_M
        left = rank_candidates(c, c.path_m[: c.n], context.pose, delta_m)  # indices, not blocked
        if np.isfinite(c.path_m[left]).any():
            return True
        self._visit.exploring_id, self._visit.explored_id = 0, room.id
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
        rooms, which, visit = self._map.rooms, self._destination.which, self._visit
        kept = visit.is_final or which == "next"
        if kept and (room := rooms.room(visit.chosen_id)) is not None:
            return room
        known = self._known_rooms()
        found = [room for room in known if not is_closed(room, self._map, self._kind)]
        visit.closed_room = known[0] if known and not found else None
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
        chosen = next((room for room in found if room.id == visit.chosen_id), None)
        if chosen is None and found:
            chosen = min(found, key=lambda room: (self._distance_m(room), room.id))
        number = 0 if chosen is None else chosen.id
        if number != visit.chosen_id:
            visit.chosen_id = number
            self._chooser.abandon()
        return chosen

    def _known_rooms(self) -> list[MappedRoom]:
        """Return the rooms that the target may mean."""
        return rooms_of(self._destination, self._map)

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
        destination: ExploreTarget
        | CheckTarget
        | DescribedObject
        | EveryRoomTarget
        | EveryObjectTarget,
        mission: MissionRun,
        semantic_map: SemanticMap,
        goals: GoalTracker,
    ) -> None:
        super().__init__(room_target(destination.room), mission, semantic_map, goals)
        self._phrase, self._activity = f"the {destination.room}", "exploring"
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
            left = "" if self._limit_s is None else f", {time_left(left_s)}"
            self._mission.activity = f"{self._activity} {self._phrase}{left}"
            if self._follow_goal(context, images) and self._chooser.search.exhausted:
                self.end(context.now_ns)  # no candidate in the room is left

    def arrive(self, evidence: str, now_ns: int) -> None:
        self._inside = self._map.rooms.room(self._visit.chosen_id)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        if self._inside is None:
            return super().select(context, scores, images)
        if self._chooser.search.exhausted:  # retries and second looks would lead elsewhere
            self._goals.idle()
            return None
        self._block_outside(self._inside)
        return self._chooser.choose(context, self._map.grid, scores, images)

    def _failure_reason(self) -> str:
        missing = f"{'no path to the' if self._visit.chosen_id else 'no'} {self._destination.name}"
        return self._chooser.failure_reason(self._mission, self._map.grid, missing)

    def end(self, now_ns: int) -> None:
        """End the target: the room is explored, or the time is over."""
        known = f"{self._phrase} was not reached"
        if self._inside is not None:
            found = objects_found(self._map, self._inside)
            name = self._phrase.removeprefix("the ")
            known = f"{name}: {self._inside.area_m2:.0f} m² are known, {found}"
        self._mission.on_reached(known, now_ns, known)

    def _in_room(self, instances: Sequence[Instance]) -> list[Instance]:
        """Return those of the objects that are in the room; none before the robot was inside.

        A part of the room that the map has cut off may have its name now.
        """
        if self._inside is None:
            return []
        rooms = [self._inside, *(room for room in self._known_rooms() if room.is_named)]
        xy_m = np.array([one.center_m[:2] for one in instances], np.float32).reshape(-1, 2)
        return list(compress(instances, np.any([self._is_in(xy_m, one) for one in rooms], axis=0)))


class SearchRoomPursuit(ExploreRoomPursuit):
    """Pursuit of an object in one room: it fails as soon as the room is explored.

    Once the robot is inside, this room counts, even if it is taken for another kind then.
    """

    @property
    def _target_label(self) -> str:
        target = self._mission.target
        return target if self._inside is None else without_room(target)

    def target_objects(self) -> Sequence[Instance]:
        known = self._known_objects()
        return known if self._inside is None else self._in_room(known)

    def check_progress(self, context: PolicyInput, images: int) -> None:
        self._begin(context)
        super().check_progress(context, images)

    def end(self, now_ns: int) -> None:
        missed = "did not get to" if self.target_objects() else "no"
        reason = f"{missed} {self._mission.target}: the room is explored"
        self._mission.abandon_target(reason, now_ns)


class CheckRoomPursuit(ExploreRoomPursuit):
    """Pursuit that checks if an object is in one room."""

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

    def target_objects(self) -> Sequence[Instance]:
        return self._in_room(self._known_objects())

    def check_progress(self, context: PolicyInput, images: int) -> None:
        if found := self._in_room(self._answer.new_detections(context)):
            self._answer.answer_yes(found, context)
        elif not self._answer.time_is_over(context.now_ns):
            super().check_progress(context, images)

    def end(self, now_ns: int) -> None:
        self._answer.answer_no("the room is explored", now_ns)

    def _is_reached(self, instance: Instance, pose: SE2) -> bool:
        """Return False: only a new detection counts, and `check_progress` handles those."""
        return False
