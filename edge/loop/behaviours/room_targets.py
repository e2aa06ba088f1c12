"""Rooms as targets of a mission: which rooms are meant, which are known, which are closed."""

from __future__ import annotations

import numpy as np

from edge.loop.prior import LEAST, MOST
from edge.loop.semantic_map import SemanticMap
from edge.memory import MappedRoom, RoomMemory, Site
from edge.mission.destinations import RoomTarget
from edge.mission.run import MissionRun
from edge.mission.spec import MissionError, MissionSpec
from edge.text import one_line


class RoomKindPrior:
    """A prior of frontiers by the kind of room that they are in or lead to."""

    def __init__(self, rooms: RoomMemory, kind: str) -> None:
        self._rooms, self._kind = rooms, kind

    def likelihood_ratio(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """See `TargetPrior.likelihood_ratio`; the target is the kind of room."""
        np.clip(self._rooms.kind_ratio(self._kind, xy_m[:n]), LEAST, MOST, out=out[:n])


def rooms_of(target: RoomTarget, here: SemanticMap) -> list[MappedRoom]:
    """Return the known rooms that a target may mean, without the largest one."""
    rooms = here.rooms
    if target.which == "called":
        return rooms.find(target.name)
    if target.which == "next":
        return [room for room in rooms.rooms if not room.is_visited]
    if target.which == "with":
        shown, min_hits = here.objects.read_only, here.config.perception.min_hits
        return rooms.with_thing(target.name, shown, min_hits)[:1]
    return []


def is_closed(room: MappedRoom, here: SemanticMap, kind: str | None = None) -> bool:
    """Return True if zones, or the mission itself, close all of a room.

    If only its objects show that it is of `kind`, it is closed, too, if most of these objects are
    in a zone. So neither the open part of an open-plan kitchen nor the room from which a closed
    kitchen is visible is a kitchen to go to.

    Args:
        room: The room.
        here: The semantic map.
        kind: The wanted kind of room; None if the room is wanted for another reason.
    """
    zones = here.grid.zones
    if not zones.any:
        return False
    if all(zones.contains(x_m, y_m) for x_m, y_m in room.points_m.tolist()):
        return True
    if kind is None or room.is_named:
        return False
    xy_m, weights = here.rooms.evidence(room, kind)
    shows_it = weights > 0.0
    closed = [zones.contains(x_m, y_m) for x_m, y_m in xy_m[shows_it].tolist()]
    weights = weights[shows_it]
    return bool(weights @ np.array(closed, np.float64) > 0.5 * weights.sum())


def refuse_closed(spec: MissionSpec, site: Site, here: SemanticMap) -> None:
    """Refuse a mission to a room if a zone closes each room that it may mean.

    Raises:
        MissionError: there is such a zone.
    """
    for name in spec.automaton.possible:
        target = spec.translation.destinations.get(name)
        rooms = rooms_of(target, here) if isinstance(target, RoomTarget) else []
        if rooms and all(zones := [room.closed_by(site) for room in rooms]):
            raise MissionError(
                f"mission: {one_line(name)} is closed by the zone {one_line(zones[0])!r}; remove "
                "the zone or name another room"
            )


def known_targets(mission: MissionRun, here: SemanticMap) -> dict[str, int]:
    """Return the destinations of a mission that are known, each with the id of its newest room.

    A destination that is no room is always known, with id 0.
    """
    known = {}
    for name, target in mission.destinations.items():
        if not isinstance(target, RoomTarget):
            known[name] = 0
        elif found := rooms_of(target, here):
            known[name] = max(room.id for room in found)
    return known


def close_forbidden(mission: MissionRun, here: SemanticMap) -> None:
    """Close the rooms that the mission must not reach now, as zones; open all others."""
    closed: list[MappedRoom] = []
    for name in () if mission.done else mission.forbidden:
        target = mission.destinations.get(name)
        if isinstance(target, RoomTarget):
            closed += here.rooms.matching(target.name)
    here.close_rooms(closed)
