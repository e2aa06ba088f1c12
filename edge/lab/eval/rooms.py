"""`edge eval rooms`: explore houses whose kinds of rooms are known, and judge the mapped rooms."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edge.config import Config, load, parse
from edge.errors import UserError
from edge.lab.eval import world_list
from edge.lab.eval.arms import LOCKSTEP, data_of, merged
from edge.lab.eval.closed_loop import ClosedLoop, wants_colour
from edge.lab.eval.intervals import Interval, wilson
from edge.lab.eval.true_rooms import true_room_at
from edge.lab.sim.base import World
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


def explore(config: Config, world: World) -> ClosedLoop:
    """Return a closed loop that has explored the world for `EXPLORE_S`; the caller closes it."""
    settings = {"mission": {"instruction": "explore the house"}}
    config = parse(merged(data_of(config), LOCKSTEP, settings), config.path)
    return ClosedLoop(config, world=world, colour=wants_colour(config)).run(EXPLORE_S)


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
    for house_config, world in worlds_of(config, args.worlds):
        loop = explore(house_config, world)
        verdicts += judge_rooms(world, loop.service.map.rooms)
        loop.close()
    print(report(verdicts))
    return 0


def report(verdicts: list[RoomVerdict]) -> str:
    """Return the table of an evaluation, with intervals at 95 %."""
    judged = [one for one in verdicts if one.share >= _SAME_ROOM_SHARE]
    well_seen = [one for one in judged if one.typical >= TYPICAL]
    rows = [("measure", "value", "95 %", "n")]
    for name, among, right in (
        ("kind is right, two or more typical objects seen", well_seen, _is_right),
        ("most likely kind is right, the same rooms", well_seen, lambda v: v.best == v.truth),
        ("kind is right, of all rooms with a kind", [v for v in judged if v.kinds], _is_right),
    ):  # fmt: skip
        rows.append(_row(name, [right(one) for one in among]))
    return format_table(rows, left=1)


def _is_right(verdict: RoomVerdict) -> bool:
    """Return True if the robot reports the true kind, and no kind that is not there."""
    return verdict.truth in verdict.kinds and verdict.also.issuperset(verdict.kinds)


def _row(name: str, right: list[bool]) -> tuple[str, str, str, str]:
    share: Interval = wilson(sum(right), len(right))
    return name, f"{share.value:.3f}", f"{share.low:.3f} to {share.high:.3f}", str(len(right))
