"""Questions to the memory after exploring: "where is the …?" for what is really there."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from edge.bus.verbs import Request
from edge.config import Config
from edge.errors import UserError
from edge.lab.eval.episodes import Episode, make_episode, world_setups
from edge.lab.eval.ground_truth import named
from edge.lab.eval.missions import MissionCostFields
from edge.lab.sim.base import World, WorldError, free_poses
from edge.loop.memory_requests import handle_memory
from edge.loop.service import Service

log = logging.getLogger("edge.lab.eval.questions")
PLACE_M = 1.0
RIGHT, WRONG_PLACE, NOT_SEEN = "right", "wrong place", "not seen"
EXPLORE = "explore the house"


def plan_questions(
    config: Config, worlds: Sequence[dict], targets: Sequence[str], seed: int
) -> list[Episode]:
    """Plan an episode for each world: explore it, then ask for each target that is there.

    Args:
        config: gives the robot and its sensors.
        worlds: sections `sim.world`; empty: the configuration's own world.
        targets: names to ask for, if the robot can get to such an object.
        seed: of the starts.

    Raises:
        UserError: no world has any of the targets.
    """
    episodes = []
    for world, section, sensing, radius_m in world_setups(config, worlds):
        fields = MissionCostFields(world, radius_m)
        asks = tuple(target for target in targets if fields.has(target))
        try:
            (pose,) = free_poses(world, 1, seed, radius_m)
        except WorldError as error:
            log.warning("evaluation goes on without this world: %s", error)
            continue
        start = (round(pose.x_m, 3), round(pose.y_m, 3), round(pose.yaw_rad, 3))
        if asks:
            episodes.append(
                make_episode(
                    section, world.name, start, 0.0, sensing, instruction=EXPLORE, asks=asks
                )
            )
    if not episodes:
        raise UserError("no world has any of the targets; choose other --targets")
    return episodes


def answers_of(service: Service, world: World, asks: Sequence[str], now_ns: int) -> dict[str, str]:
    """Ask a service for objects, and judge the first place of each answer.

    Returns:
        By name: `RIGHT` if the place is within `PLACE_M` of the footprint of such an object,
        `WRONG_PLACE` if not, `NOT_SEEN` if the answer has no place.
    """
    return {name: _verdict(service, world, name, now_ns) for name in asks}


def _verdict(service: Service, world: World, name: str, now_ns: int) -> str:
    objects = handle_memory(service, Request("find", {"name": name}), now_ns)["objects"]
    if not objects:
        return NOT_SEEN
    x_m, y_m = objects[0]["xyz"][:2]
    away_m = min(item.distance_m(x_m, y_m) for item in named(world, name))
    return RIGHT if away_m <= PLACE_M else WRONG_PLACE
