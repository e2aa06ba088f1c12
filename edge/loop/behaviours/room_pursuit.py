"""Pursuit of a room: find it by what is in it, and go inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edge.config import PolicySearch
from edge.loop.behaviours.pursuit import Pursuit
from edge.loop.goal import GoalTracker
from edge.loop.prior import LEAST, MOST
from edge.loop.semantic_map import SemanticMap
from edge.memory import RECOGNISED_KINDS, MappedRoom, RoomMemory, kind_of_room
from edge.mission.destinations import RoomTarget
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.policies.search import SearchPolicy
from edge.text import one_line
from edge.types import Goal, Instance

_REACH_M = np.array([0.5])


class RoomPursuit(Pursuit):
    """Pursuit of a room: explore where it is likely; when it is known, go inside."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def judge(self, context: PolicyInput, images: int) -> None:
        mission, rooms = self._mission, self._map.rooms
        room = self._choose(context)
        if room is None:
            mission.activity = "exploring to find it"
            super().judge(context, images)
            return
        why = f": {room.reason}" if room.reason else ""
        name = room.title if room.title == f"room {room.id}" else f"{room.title}, room {room.id}"
        if rooms.entered(context.pose.x_m, context.pose.y_m) == room.id:
            self._goals.drop()
            mission.on_reached(one_line(f"inside the {name}{why}"), context.now_ns)
            return
        mission.activity = one_line(f"going to the {name}{why}")
        super().judge(context, images)

    def finish(self, now_ns: int) -> None:
        mission, target = self._mission, self._target
        if target.which == "largest" and not target.room and self._map.rooms.rooms:
            largest = max(self._map.rooms.rooms, key=lambda room: room.area_m2)
            mission.destinations[mission.target] = replace(target, room=largest.id)
            return
        super().finish(now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        target, grid, goals = self._target, self._map.grid, self._goals
        room = self._map.rooms.room(target.room)
        if room is not None:
            goal = goals.go_to_point(context, grid, room.points_m, self._mission.target)
            return goal or goals.go_near(context, grid, room.xy_m, images)
        prior = None
        kind = kind_of_room(target.name) if target.which == "called" else None
        if kind in RECOGNISED_KINDS:
            prior = _KindPrior(self._map.rooms, kind)
        if target.which != "with":
            scores = SearchPolicy(PolicySearch()).score(replace(context, prior=prior))
        return goals.choose(context, grid, np.asarray(scores, np.float32), images)

    @property
    def _target(self) -> RoomTarget:
        target = self._mission.destinations[self._mission.target]
        assert isinstance(target, RoomTarget)
        return target

    def _choose(self, context: PolicyInput) -> MappedRoom | None:
        """Return the room to go to, and keep the choice in the mission; None if none is known."""
        mission, target, rooms = self._mission, self._target, self._map.rooms
        if target.which in ("largest", "next") and (room := rooms.room(target.room)) is not None:
            return room
        found = rooms_of(target, self._map)
        if target.which == "next":
            here = rooms.room_at(context.pose.x_m, context.pose.y_m)
            beside = {door.room for door in here.doors} if here is not None else set()
            found = [room for room in found if room.id in beside] or found
            found = [room for room in found if np.isfinite(self._path_m(room))]
        chosen = next((room for room in found if room.id == target.room), None)
        if chosen is None and found:
            chosen = min(found, key=lambda room: (self._path_m(room), room.id))
        number = 0 if chosen is None else chosen.id
        if number != target.room:
            mission.destinations[mission.target] = replace(target, room=number)
            self._goals.drop()
        return chosen

    def _path_m(self, room: MappedRoom) -> float:
        """Return the driving distance to a room; inf if no path is known."""
        n, path_m = len(room.points_m), np.empty(len(room.points_m), np.float32)
        self._map.grid.reach.path_lengths_m(
            room.points_m, np.zeros(n, np.int8), _REACH_M, n, path_m
        )
        return float(path_m.min(initial=np.inf))


class _KindPrior:
    """A prior of frontiers by the kind of room that they are in or lead to."""

    def __init__(self, rooms: RoomMemory, kind: str) -> None:
        self._rooms, self._kind = rooms, kind

    def lift(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """See `TargetPrior.lift`."""
        np.clip(self._rooms.kind_ratio(self._kind, xy_m[:n]), LEAST, MOST, out=out[:n])


def rooms_of(target: RoomTarget, here: SemanticMap) -> list[MappedRoom]:
    """Return the known rooms that a target may mean; none for the largest room."""
    rooms = here.rooms
    if target.which == "called":
        return rooms.called(target.name)
    if target.which == "next":
        return [room for room in rooms.rooms if not room.is_visited]
    if target.which == "with":
        shown, min_hits = here.sightings.shown, here.config.perception.min_hits
        return rooms.with_thing(target.name, shown, min_hits)[:1]
    return []


def known_targets(mission: MissionRun, here: SemanticMap) -> dict[str, int]:
    """Return the destinations of a mission that are known, each with the id of its newest room.

    A destination that is no room is always known, with id 0.
    """
    known = {}
    for name, target in mission.destinations.items():
        if not isinstance(target, RoomTarget):
            known[name] = 0
        elif target.room or (found := rooms_of(target, here)):
            known[name] = target.room or max(room.id for room in found)
    return known


def close_forbidden(mission: MissionRun, here: SemanticMap) -> None:
    """Close the rooms that the mission must not reach now, as zones; open all others."""
    closed: list[MappedRoom] = []
    for name in () if mission.done else mission.forbidden:
        target = mission.destinations.get(name)
        if isinstance(target, RoomTarget) and target.which == "called":
            closed += here.rooms.matching(target.name)
    here.close_rooms(closed)
