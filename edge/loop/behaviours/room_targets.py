"""Rooms as targets of a mission: the rooms that a target may mean, and rooms that are closed.

The search behaviour and its `RoomPursuit` use it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.loop.scoring.prior import LEAST, MOST
from edge.loop.semantic_map import SemanticMap
from edge.memory import MappedRoom, RoomMemory, Site
from edge.mission.destinations import PlaceTarget, RoomTarget
from edge.mission.instructions import MissionError
from edge.mission.run import MissionRun
from edge.mission.spec import MissionSpec
from edge.text import one_line


class RoomKindPrior:
    """A prior of frontiers by the kind of room that they are in or lead to."""

    def __init__(self, rooms: RoomMemory, kind: str) -> None:
        self._rooms, self._kind = rooms, kind

    def likelihood_ratio(self, target: str, xy_m: np.ndarray, n: int, out: np.ndarray) -> None:
        """See `TargetPrior.likelihood_ratio`. `target` is not used: the kind was given."""
        np.clip(self._rooms.kind_ratio(self._kind, xy_m[:n]), LEAST, MOST, out=out[:n])


def rooms_of(target: RoomTarget, semantic_map: SemanticMap) -> list[MappedRoom]:
    """Return the known rooms that a target may mean, the most likely first for `with`.

    For `largest` it returns []: until all is explored, another room may be larger. `RoomPursuit`
    chooses it at the end.
    """
    rooms = semantic_map.rooms
    if target.which == "called":
        return rooms.find(target.name)
    if target.which == "next":
        return [room for room in rooms.rooms if not room.is_visited]
    if target.which == "with":  # "the room with the sofa": only the most likely one
        shown, min_hits = semantic_map.objects.read_only, semantic_map.config.perception.min_hits
        return rooms.with_object(target.name, shown, min_hits)[:1]
    return []  # `largest`


def is_closed(room: MappedRoom, semantic_map: SemanticMap, kind: str | None = None) -> bool:
    """Return True if zones, or the mission itself, close all of a room.

    If only its objects show that it is of `kind`, it is closed, too, if most of these objects are
    in a zone. So neither the open part of an open-plan kitchen nor the room from which a closed
    kitchen is visible is a kitchen to go to.
    """
    zones = semantic_map.grid.zones
    if not zones.any:
        return False
    if all(zones.contains(x_m, y_m) for x_m, y_m in room.points_m.tolist()):
        return True
    if kind is None or room.is_named:
        return False
    xy_m, weights = semantic_map.rooms.evidence(room, kind)
    shows_it = weights > 0.0
    closed = [zones.contains(x_m, y_m) for x_m, y_m in xy_m[shows_it].tolist()]
    weights = weights[shows_it]
    return bool(weights @ np.array(closed, np.float64) > 0.5 * weights.sum())


def refuse_closed(spec: MissionSpec, site: Site, semantic_map: SemanticMap) -> None:
    """Refuse a mission to a room if a zone closes each room that it may mean.

    Raises:
        MissionError: there is such a zone.
    """
    for name in spec.automaton.possible:
        target = spec.translation.destinations.get(name)
        rooms = rooms_of(target, semantic_map) if isinstance(target, RoomTarget) else []
        zones = [room.closed_by(site) for room in rooms]  # "" for a room that is open
        if rooms and all(zones):
            raise MissionError(
                f"mission: {one_line(name)} is closed by the zone {one_line(zones[0])!r}; remove "
                "the zone or name another room"
            )


def known_targets(mission: MissionRun, semantic_map: SemanticMap) -> dict[str, int]:
    """Return the destinations of a mission that are known, each with the id of its newest room.

    The mission notices by a higher id that another room became known. A destination that is no room
    is always known, with id 0.
    """
    known = {}
    for name, target in mission.destinations.items():
        if not isinstance(target, RoomTarget):
            known[name] = 0
        elif found := rooms_of(target, semantic_map):
            known[name] = max(room.id for room in found)
    return known


def positions_of_target(
    mission: MissionRun, semantic_map: SemanticMap, name: str
) -> list[Sequence[float]]:
    """Return the positions (x, y) of a target; [] if none is known."""
    target = mission.destinations.get(name)
    if isinstance(target, PlaceTarget):
        return [] if target.pose is None else [(target.pose.x_m, target.pose.y_m)]
    if isinstance(target, RoomTarget):
        return [at for room in rooms_of(target, semantic_map) for at in room.points_m.tolist()]
    return [instance.center_m[:2].tolist() for instance in semantic_map.tracker.of(name)]


def close_forbidden(mission: MissionRun, semantic_map: SemanticMap) -> None:
    """Close the rooms that the mission must not reach now, as zones; open all others."""
    closed: list[MappedRoom] = []
    for name in () if mission.done else mission.progress.forbidden:
        target = mission.destinations.get(name)
        if isinstance(target, RoomTarget):
            closed += semantic_map.rooms.matching(target.name)  # all rooms of this name or kind
    semantic_map.close_rooms(closed)
