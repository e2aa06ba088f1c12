"""Evaluates the answers to "where is the …?", for objects of a house that was just explored."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from edge.bus.verbs import Request
from edge.config import Config
from edge.lab.eval.episodes import Episode, first_episodes, make_episode, world_setups
from edge.lab.eval.ground_truth import objects_meant_by
from edge.lab.eval.missions import MissionCostFields
from edge.lab.eval.outcome import RIGHT
from edge.lab.eval.rooms import RoomVerdict, judge_rooms
from edge.lab.eval.true_rooms import true_room_at
from edge.lab.sim.base import World, free_poses, start_at
from edge.loop.requests.memory_requests import handle_memory
from edge.loop.service import Service

MAX_ERROR_M = 1.0  # of the place in a right answer
# The other verdicts on an answer; `RIGHT` is one, too.
NOT_SEEN, WRONG_PLACE, WRONG_ROOM = "not seen", "wrong place", "wrong room"
EXPLORE = "explore the house"


def plan_questions(
    config: Config,
    worlds: Sequence[dict],
    targets: Sequence[str],
    seed: int,
    limit: int | None = None,
) -> list[Episode]:
    """Plan an episode for each world: explore it, then ask for each target that is there.

    Targets that the robot cannot get to are not asked for. Without `worlds` (sections `sim.world`),
    it is the configuration's own. Only the first `limit` are planned.

    Raises:
        UserError: no world has any of the targets.
    """

    def planned() -> Iterator[Episode]:
        for world, section, sensing, radius_m in world_setups(config, worlds):
            fields = MissionCostFields(world, radius_m)
            asks = tuple(target for target in targets if fields.has(target))
            (pose,) = free_poses(world, 1, seed, radius_m)
            if asks:
                yield make_episode(
                    section, world.name, start_at(pose), 0.0, sensing, instruction=EXPLORE,
                    asks=asks,
                )  # fmt: skip

    problem = "no world has any of the targets; choose other --targets"
    return first_episodes(planned(), limit, problem)


def answers_of(service: Service, world: World, asks: Sequence[str], now_ns: int) -> dict[str, str]:
    """Ask a service for objects, and judge the first place of each answer, and its room.

    Returns:
        By name: `RIGHT`; `WRONG_PLACE` if the place is over `MAX_ERROR_M` from the footprints of
        such objects; `WRONG_ROOM` if the answer does not name the kind of the true room, or names
        a kind that is not there; `NOT_SEEN` if the answer has no place. Rooms are judged in
        worlds that have their kinds.
    """
    rooms = judge_rooms(world, service.map.rooms) if asks and world.room_kinds else []
    judged = {room.id: room for room in rooms}  # by id of the mapped room
    return {name: _verdict(service, world, name, now_ns, judged) for name in asks}


def _verdict(
    service: Service, world: World, name: str, now_ns: int, judged: dict[int, RoomVerdict]
) -> str:
    objects = handle_memory(service, Request("find", {"name": name}), now_ns)["objects"]
    if not objects:
        return NOT_SEEN
    x_m, y_m = objects[0]["xyz"][:2]
    item = min(objects_meant_by(world, name), key=lambda obj: obj.distance_m(x_m, y_m))
    if item.distance_m(x_m, y_m) > MAX_ERROR_M:
        return WRONG_PLACE
    at = int(true_room_at(world, np.array([item.center_m[:2]]))[0])
    if at < 0 or not world.room_kinds:
        return RIGHT
    room, truth = service.map.rooms.room_at(x_m, y_m), world.room_kinds[at]
    true_kinds = (
        {truth} if room is None or room.id not in judged else {truth} | judged[room.id].also
    )
    named_right = room is not None and truth in room.kinds and true_kinds.issuperset(room.kinds)
    return RIGHT if named_right else WRONG_ROOM
