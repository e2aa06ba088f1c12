"""Episodes of an evaluation: a target or a mission in a world, from a start.

Episodes are planned once, then run with any arm (one of the configurations to compare). A section
is a part of a configuration, such as `sim.world`. In a session, the robot searches for several
goals one after another.

A file of episodes (JSON lines) holds all that a rerun needs: the world's section, the start, the
task, the shortest path, and the sensors.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from edge import names
from edge.config import Config, parse
from edge.errors import UserError
from edge.host.files import save
from edge.host.progress import with_progress
from edge.lab.eval import geodesic, world_list
from edge.lab.eval.arms import data_of, merged
from edge.lab.eval.json_lines_file import parser_of, read_lines
from edge.lab.eval.missions import MissionCostFields, draw_missions
from edge.lab.eval.planning.delexicalised import compiled
from edge.lab.sim.base import World, WorldError, free_poses, start_at
from edge.lab.sim.worlds import load_world
from edge.memory import ROOM_KINDS
from edge.text import one_line

log = logging.getLogger("edge.lab.eval.episodes")
MAX_BYTES = 1 << 28
"""Largest file of episodes that is read."""
Length = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
"""A length in a file, in m."""
_POSES = 20  # starts to try for a mission

COMMON_TARGETS = (
    "bed", "chair", "house plant", "sofa", "television", "toilet",
    "dining table", "chest of drawers", "refrigerator", "countertop", "trash can", "tv stand",
    "floor lamp", "armchair", "shelf", "side table",
)  # fmt: skip
"""Targets of `--targets common`.

The six of ObjectNav, and the ten large objects (at least 0.5 m, 0.09 m³) that most houses of
`procthor_train` have.
"""


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode: a start in a world, and a target, an instruction or a session of several goals.

    Attributes:
        id: unique; changes with any other field.
        world: `sim.world` of the configuration.
        start: x and y [m], yaw [rad], in `map`.
        target: name of the object to find, or kind of the room to go to; None for an instruction
            and a session.
        instruction: text of the mission; None for a target and a session.
        shortest_m: shortest path to success, by ground truth; 0 for a session, whose goals have
            their own.
        sensing: sections `robot`, `sensors` and `sim`, the same for every arm, unless an arm
            changes them.
        goals: names of the objects and kinds of rooms to find one after another
            (`edge.lab.eval.sessions`).
        moved: share of the movable objects that are moved before each goal but the first; 0 to 1.
        site: zones, as GeoJSON (`edge.lab.eval.zones`); empty if there are none.
        ways: "detour" if a path around the zones is left, "closed" if not; "" without zones.
        asks: names to ask for at the end (`edge.lab.eval.questions`).
    """

    id: str
    world: dict[str, Any]
    start: tuple[float, float, float]
    target: str | None
    instruction: str | None
    shortest_m: Length
    sensing: dict[str, Any] = field(default_factory=dict)
    goals: tuple[str, ...] = ()
    moved: float = 0.0
    site: dict[str, Any] = field(default_factory=dict)
    ways: str = ""
    asks: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[str, ...]:
        """The ids of its outcomes: one, or one for each goal of a session."""
        goals = range(1, len(self.goals) + 1)
        return tuple(f"{self.id}/{k}" for k in goals) or (self.id,)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that the episode adds to a configuration, without `sensing`."""
        mission: dict[str, Any] = {"instruction": self.instruction}
        if self.instruction is None:
            mission = mission_for(self.goals[0] if self.goals else str(self.target))
        return {
            "mission": {**mission, "checkpoint": None}, "sim": {"start": list(self.start)},
        }  # fmt: skip


def mission_for(goal: str) -> dict[str, Any]:
    """Return the settings of a mission to an object by name, or to a room by its kind."""
    if goal in ROOM_KINDS:
        return {"instruction": f"go to the {goal}"}
    return {"target": goal, "instruction": None}


def make_episode(
    world: dict[str, Any],
    name: str,
    start: tuple[float, float, float],
    shortest_m: float,
    sensing: dict[str, Any],
    target: str | None = None,
    instruction: str | None = None,
    **more: Any,
) -> Episode:
    """Build an episode of the world with this name. Other arguments are fields of `Episode`.

    Its id is readable and includes a hash of the content.
    """
    # An empty `more` is left out, so that the ids of plain episodes stay as they were.
    content = [world, start, target, instruction, sensing, *([more] if more else [])]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:8]
    what = one_line(target or instruction or "session", 40).replace(" ", "-")
    episode_id = f"{name}/{what}/{digest}"
    return Episode(episode_id, world, start, target, instruction, shortest_m, sensing, **more)


def sensing_settings(config: Config) -> dict[str, Any]:
    """Return the settings that all arms share: the robot, its sensors, and their noise."""
    sensing = config.model_dump(mode="json", include={"robot", "sensors", "sim"})
    for key in ("world", "start", "lockstep"):
        del sensing["sim"][key]
    return sensing


def first_episodes(planned: Iterator[Episode], limit: int | None, problem: str) -> list[Episode]:
    """Return the first episodes, at most `limit`; the worlds of the others are not even loaded.

    Raises:
        UserError: there are none. `problem` is the message.
    """
    episodes = list(islice(planned, limit))
    if not episodes:
        raise UserError(problem)
    return episodes


def plan(
    config: Config,
    worlds: Sequence[dict[str, Any]],
    targets: Sequence[str],
    starts: int,
    seed: int,
    min_distance_m: float,
    per_world: int | None = None,
    min_size_m: float = 0.0,
    limit: int | None = None,
) -> list[Episode]:
    """Plan episodes: seeded starts for targets in worlds, which are objects and kinds of rooms.

    `worlds` are sections `sim.world`. If there are none, it is the configuration's own, which must
    have every target. Else a target is skipped where it is missing, or if all its objects are
    smaller than `min_size_m`. At most `per_world` episodes of each world are kept, drawn at random.
    `min_distance_m` is the shortest allowed path from a start. Only the first `limit` are planned.

    Raises:
        UserError: a world cannot be loaded, or no episode is possible.
    """

    def planned() -> Iterator[Episode]:
        for setup in world_setups(config, worlds):
            world = setup.world
            here = {o.label for o in world.objects if max(o.size_m) >= min_size_m}
            here.update(world.room_kinds)
            present = [t for t in targets if any(names.same_name(name, t) for name in here)]
            if not worlds and len(present) < len(targets):
                missing = next(target for target in targets if target not in present)
                raise UserError(
                    f"world {world.name}: nothing is a {missing!r} (choices: "
                    f"{', '.join(sorted(here))})"
                )
            found = _plan_in_world(setup, present, starts, seed, min_distance_m)
            if not worlds and len(found) < starts * len(present):
                log.warning(
                    "world %s: only %d of %d starts are %g m or more of driving from their target",
                    world.name, len(found), starts * len(present), min_distance_m,
                )  # fmt: skip
            yield from _draw(found, per_world, seed, world.name)

    return first_episodes(
        planned(), limit,
        f"no world has a start {min_distance_m:g} m or more of driving from one of the targets; "
        "choose other --targets or a smaller --min-distance",
    )  # fmt: skip


def plan_missions(
    config: Config,
    worlds: Sequence[dict[str, Any]],
    targets: Sequence[str],
    count: int,
    seed: int,
    min_distance_m: float,
    limit: int | None = None,
) -> list[Episode]:
    """Plan at most `count` seeded missions with several targets in each world (ViTL V-D).

    Each has its own start, and a path of at least `min_distance_m`. It uses those of `targets` that
    the robot can get to. Without `worlds` (sections `sim.world`), it is the configuration's own.
    Only the first `limit` are planned.

    Raises:
        UserError: a world cannot be loaded, or no mission is possible.
    """

    def planned() -> Iterator[Episode]:
        for number, setup in enumerate(world_setups(config, worlds)):
            # Each world has other missions.
            yield from _missions_in_world(
                setup, targets, count, seed + 1_000_000 * number, min_distance_m
            )

    return first_episodes(
        planned(), limit,
        f"no world has a mission to two targets with a path of {min_distance_m:g} m or more; "
        "choose other --targets or a smaller --min-distance",
    )  # fmt: skip


def _missions_in_world(
    setup: WorldSetup, targets: Sequence[str], count: int, seed: int, min_distance_m: float
) -> Iterator[Episode]:
    """Plan missions in one world; see `plan_missions`."""
    world, section, sensing, radius_m = setup
    fields = MissionCostFields(world, radius_m)
    present = [target for target in targets if fields.has(target)]
    for k, mission in enumerate(draw_missions(present, count, seed)):
        distances_m = fields.cost_to_go_m(compiled(mission.formula))
        # Each mission has its own seed. The first pose that is far enough is its start.
        for pose in free_poses(world, _POSES, seed + 1000 * k, radius_m):
            shortest_m = geodesic.value_at(world.plan, distances_m, pose.x_m, pose.y_m)
            if min_distance_m <= shortest_m < math.inf:
                yield make_episode(
                    section, world.name, start_at(pose), round(shortest_m, 4), sensing,
                    instruction=mission.sentence,
                )  # fmt: skip
                break


class WorldSetup(NamedTuple):
    """A loaded world, and settings for its episodes.

    Attributes:
        section: `sim.world` of the configuration.
        sensing: see `Episode`.
        radius_m: radius of the robot's footprint.
    """

    world: World
    section: dict[str, Any]
    sensing: dict[str, Any]
    radius_m: float


def world_setups(config: Config, worlds: Sequence[dict[str, Any]]) -> Iterator[WorldSetup]:
    """Load the worlds of these sections, or the configuration's own if there are none.

    A section's world whose own start has no room for the robot is skipped with a warning.
    """
    sensing, radius_m = sensing_settings(config), config.robot.radius_m
    if not worlds:
        section = config.sim.world.model_dump(mode="json")
        yield WorldSetup(load_world(config), section, sensing, radius_m)
        return
    for section in with_progress("worlds", worlds):
        data = merged(data_of(config), {"sim": {"world": section, "start": None}})
        world = world_list.load(parse(data, f"{config.path} with --worlds"))
        try:
            free_poses(world, 1, 0, radius_m)
        except WorldError as error:
            log.warning("evaluation goes on without this world: %s", error)
            continue
        yield WorldSetup(world, section, sensing, radius_m)


def _plan_in_world(
    setup: WorldSetup,
    targets: Sequence[str],
    starts: int,
    seed: int,
    min_distance_m: float,
) -> list[Episode]:
    """Plan at most `starts` episodes for each target in one world."""
    world, section, sensing, radius_m = setup
    fields = MissionCostFields(world, radius_m)
    episodes: list[Episode] = []
    for k, target in enumerate(targets):
        distances_m = fields.distance_m(target)
        # Many poses are too near to the target. Each target has its own seed.
        poses = free_poses(world, 50 * starts, seed + 1000 * k, radius_m)
        found = []
        for pose in poses:
            shortest_m = geodesic.value_at(world.plan, distances_m, pose.x_m, pose.y_m)
            if min_distance_m <= shortest_m < math.inf and len(found) < starts:
                start, shortest_m = start_at(pose), round(shortest_m, 4)
                found.append(make_episode(section, world.name, start, shortest_m, sensing, target))
        episodes += found
    return episodes


def _draw(episodes: list[Episode], count: int | None, seed: int, name: str) -> list[Episode]:
    """Draw at most `count` of a world's episodes at random; return them in the given order."""
    if count is None or len(episodes) <= count:
        return episodes
    rng = np.random.default_rng([seed, *name.encode()])
    return [episodes[k] for k in sorted(rng.permutation(len(episodes))[:count])]


# -- files ----------------------------------------------------------------------------------------


def write(path: Path, episodes: Iterable[Episode]) -> None:
    """Write one JSON line for each episode."""
    save(path, "".join(f"{json.dumps(asdict(episode))}\n" for episode in episodes).encode())


def read(path: Path) -> list[Episode]:
    """Read the episodes of a file that `write` wrote.

    Raises:
        FileError: the file cannot be read.
        UserError: a line is not an episode, or two episodes have the same id.
    """
    episodes: dict[str, Episode] = {}
    advice = "`edge eval episodes --plan FILE` writes such a file"
    for episode in read_lines(path, MAX_BYTES, parse_episode, "an episode", advice):
        if episode.id in episodes:
            raise UserError(
                f"{path}: two episodes have the same id {one_line(episode.id)}; remove one of the "
                "lines"
            )
        episodes[episode.id] = episode
    return list(episodes.values())


_parse = parser_of(Episode)


def parse_episode(data: dict[str, Any]) -> Episode:
    """Build an episode from its JSON object.

    Raises:
        ValueError: a field is missing or wrong.
    """
    episode = _parse(data)
    if not (episode.goals or episode.target or episode.instruction):
        raise ValueError("target or instruction: expected a text, got none")
    return episode
