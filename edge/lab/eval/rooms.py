"""Evaluation of rooms: the kinds of mapped rooms, and drives to a named room.

`edge eval rooms` explores houses with known kinds of rooms, and drives to a room of each kind.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edge.config import Config, load, parse
from edge.errors import UserError
from edge.lab.eval import world_list
from edge.lab.eval.arms import LOCKSTEP, Data, data_of, merged
from edge.lab.eval.closed_loop import ClosedLoop
from edge.lab.eval.intervals import Interval, wilson
from edge.lab.eval.true_rooms import true_room_at
from edge.lab.sim.base import World, free_poses, start_at
from edge.memory import MappedRoom, RoomMemory
from edge.memory.rooms import TYPICAL, typical_classes
from edge.text import format_table

EXPLORE_S = 180.0
"""Simulated time for exploring a house."""
_SAME_ROOM_SHARE = 0.5
"""A mapped room is judged if at least this share of its floor is in one true room."""
_PART_SHARE = 0.2
"""The kind of a true room counts, too, if at least this share of the mapped floor is in it."""


@dataclass(frozen=True, slots=True)
class RoomVerdict:
    """A mapped room, compared with the true room that most of its floor is in.

    Attributes:
        also: kinds of all true rooms with at least `_PART_SHARE` of the mapped floor.
        kinds: kinds that the robot reports; empty if none is certain.
        best: kind that the robot finds most likely, certain or not.
        typical: number of kinds of objects seen in the mapped room that are typical of the true
            kind, such as a bed of a bedroom.
    """

    id: int
    truth: str
    share: float
    also: frozenset[str]
    kinds: tuple[str, ...]
    best: str
    typical: int


@dataclass(frozen=True, slots=True)
class RoomGoalOutcome:
    """A drive to a room of a kind.

    Attributes:
        phase: how the mission ended.
        success: True if the service reported `reached` and the robot is in a room of the kind.
        seconds: simulated time.
    """

    world: str
    kind: str
    phase: str
    success: bool
    seconds: float
    reason: str


def judge_rooms(world: World, memory: RoomMemory) -> list[RoomVerdict]:
    """Compare the rooms of the map with those of the world."""
    regions, verdicts = memory.survey.regions, []
    for shape in memory.survey.shapes:
        room = memory.room(shape.id)
        cells = np.argwhere(regions.label == shape.region)
        true_rooms = true_room_at(world, regions.grid.centres_m(cells[:, 0], cells[:, 1]))
        counts = np.bincount(true_rooms[true_rooms >= 0], minlength=len(world.rooms))
        if room is None or not counts.any():
            continue
        largest = int(counts.argmax())  # index of the true room that most of the floor is in
        parts = np.flatnonzero(counts >= _PART_SHARE * len(cells)).tolist()
        also = frozenset(world.room_kinds[index] for index in parts)
        share = float(counts[largest] / len(cells))
        verdicts.append(_verdict(room, world.room_kinds[largest], share, also))
    return verdicts


def _verdict(room: MappedRoom, truth: str, share: float, also: frozenset) -> RoomVerdict:
    best = max(room.chance, key=lambda kind: room.chance[kind])
    typical = len(typical_classes(truth) & set(room.classes))
    return RoomVerdict(room.id, truth, share, also, room.kinds, best, typical)


def _loop(config: Config, world: World, instruction: str, sim: Data) -> ClosedLoop:
    """Return a closed loop with a mission and settings of the section `sim`."""
    settings = {"mission": {"instruction": instruction}, "sim": sim}
    data = merged(data_of(config), LOCKSTEP, settings)
    return ClosedLoop(parse(data, config.path), world=world, colour=False)


def explore(config: Config, world: World) -> ClosedLoop:
    """Return a closed loop that has explored the world for `EXPLORE_S`; the caller closes it."""
    return _loop(config, world, "explore the house", {}).run(EXPLORE_S)


def drive_to(
    config: Config, world: World, kind: str, start: tuple[float, float, float]
) -> RoomGoalOutcome:
    """Drive to a room of a kind in an unknown house."""
    loop = _loop(config, world, f"go to the {kind}", {"start": list(start)})
    try:
        loop.run(config.mission.time_limit_s + 5.0)
        status, pose = loop.service.status, loop.drive.motion.pose
        at = int(true_room_at(world, np.array([[pose.x_m, pose.y_m]]))[0])
        right = at >= 0 and world.room_kinds[at] == kind
        success = status.phase == "reached" and right
        return RoomGoalOutcome(world.name, kind, status.phase, success, loop.seconds, status.reason)
    finally:
        loop.close()


def worlds_of(config: Config, specs: list[str]) -> Iterator[tuple[Config, World]]:
    """Yield the configuration and the world of each house whose rooms have kinds."""
    for house_config, world in world_list.worlds(config, specs):
        if not world.room_kinds:
            raise UserError(
                f"--worlds: {world.name}: the kinds of the rooms are not known; use ProcTHOR houses"
            )
        yield house_config, world


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval rooms`."""
    data = data_of(load(args.config))
    data["perception"]["detector"] = {"kind": "sim"}
    config = parse(data, args.config)
    verdicts: list[RoomVerdict] = []
    outcomes: list[RoomGoalOutcome] = []
    for house_config, world in worlds_of(config, args.worlds):
        if not args.goals_only:
            loop = explore(house_config, world)
            verdicts += judge_rooms(world, loop.service.map.rooms)
            loop.close()
        kinds, rng = sorted(set(world.room_kinds)), random.Random(f"{args.seed} {world.name}")
        for kind in rng.sample(kinds, k=min(args.goals, len(kinds))):
            pose = _start_elsewhere(house_config, world, kind, args.seed)
            if pose is not None:
                outcomes.append(drive_to(house_config, world, kind, pose))
                print(outcomes[-1], flush=True)
    print(report(verdicts, outcomes))
    return 0


def _start_elsewhere(
    config: Config, world: World, kind: str, seed: int
) -> tuple[float, float, float] | None:
    """Return a random pose that is in no room of the kind, or None if there is none."""
    for pose in free_poses(world, 50, seed, config.robot.radius_m):
        at = int(true_room_at(world, np.array([[pose.x_m, pose.y_m]]))[0])
        if at >= 0 and world.room_kinds[at] != kind:
            return start_at(pose)
    return None


def report(verdicts: list[RoomVerdict], outcomes: list[RoomGoalOutcome]) -> str:
    """Return the tables of an evaluation, with intervals at 95 %."""
    judged = [one for one in verdicts if one.share >= _SAME_ROOM_SHARE]
    well_seen = [one for one in judged if one.typical >= TYPICAL]
    rows = [("measure", "value", "95 %", "n")]
    for name, among, right in (
        ("kind is right, two or more typical objects seen", well_seen, _is_right),
        ("most likely kind is right, the same rooms", well_seen, lambda v: v.best == v.truth),
        ("kind is right, of all rooms with a kind", [v for v in judged if v.kinds], _is_right),
    ):  # fmt: skip
        rows.append(_row(name, [right(one) for one in among]))
    rows.append(_row("room is reached", [one.success for one in outcomes]))
    return format_table(rows, left=1)


def _is_right(verdict: RoomVerdict) -> bool:
    """Return True if the robot reports the true kind, and no kind that is not there."""
    return verdict.truth in verdict.kinds and verdict.also.issuperset(verdict.kinds)


def _row(name: str, right: list[bool]) -> tuple[str, str, str, str]:
    share: Interval = wilson(sum(right), len(right))
    return name, f"{share.value:.3f}", f"{share.low:.3f} to {share.high:.3f}", str(len(right))
