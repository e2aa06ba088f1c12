"""Plans and runs sessions: several goals one after another in one house.

GOAT-Bench (Khanna et al. 2024) has such sessions.

The robot searches for each goal from the place where it found, or gave up, the last one. The
service runs all the time, so it remembers what it saw. An arm that forgets drops map and objects
before each goal. The first goal is the same for both and does not count in a comparison.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from edge.config import Config
from edge.errors import Stopped, UserError
from edge.lab.eval import world_list
from edge.lab.eval.arms import ExperimentArm
from edge.lab.eval.closed_loop import ClosedLoop, wants_colour
from edge.lab.eval.drive import (
    config_of,
    forget_distances,
    outcome_of,
    reason_of,
    remaining_m,
    step_to_end,
    truth_of,
    warm_up_once,
)
from edge.lab.eval.episodes import (
    Episode,
    first_episodes,
    make_episode,
    mission_for,
    world_setups,
)
from edge.lab.eval.ground_truth import GroundTruth, GroundTruthLogger
from edge.lab.eval.missions import MissionCostFields
from edge.lab.eval.outcome import EpisodeOutcome, crashed_outcomes
from edge.lab.sim.base import free_poses, start_at
from edge.lab.sim.boxworld import BoxWorld
from edge.lab.sim.rearrange import rearrange
from edge.lab.sim.worlds import load_world
from edge.loop.result import TickResult
from edge.tasks.mission_spec import prepare_mission

log = logging.getLogger("edge.lab.eval.sessions")


def plan_sessions(
    config: Config,
    worlds: Sequence[dict],
    targets: Sequence[str],
    count: int,
    seed: int,
    min_distance_m: float,
    moved: float = 0.0,
    limit: int | None = None,
) -> list[Episode]:
    """Plan one session of `count` goals for each world.

    A world with too few goals is skipped with a warning. `targets` are objects and kinds of rooms.
    `min_distance_m` is the shortest allowed path to a goal, from the start or from any place that
    counts as at the last goal. `moved` is the share of the movable objects that are moved before
    each goal but the first. Without `worlds` (sections `sim.world`), it is the configuration's own.
    Only the first `limit` are planned.

    Raises:
        UserError: a world cannot be loaded, or no session is possible.
    """

    def planned() -> Iterator[Episode]:
        for world, section, sensing, radius_m in world_setups(config, worlds):
            start = start_at(free_poses(world, 1, seed, radius_m)[0])
            fields = MissionCostFields(world, radius_m)
            rng = np.random.default_rng([seed, *world.name.encode()])
            shuffled = [targets[k] for k in rng.permutation(len(targets))]
            goals = _choose_goals(fields, start, shuffled, count, min_distance_m)
            if len(goals) < count:
                log.warning(
                    "evaluation goes on without the world %s: only %d of %d targets are far enough "
                    "apart",
                    world.name, len(goals), count,
                )  # fmt: skip
                continue
            yield make_episode(section, world.name, start, 0.0, sensing, goals=goals, moved=moved)

    return first_episodes(
        planned(), limit,
        f"no world has {count} of the targets, each {min_distance_m:g} m or more of driving from "
        "the one before; choose other --targets, fewer --goals or a smaller --min-distance",
    )  # fmt: skip


def _choose_goals(
    fields: MissionCostFields,
    start: tuple[float, float, float],
    names: list[str],
    count: int,
    min_distance_m: float,
) -> tuple[str, ...]:
    """Return different goals, each at least `min_distance_m` from the last.

    There are fewer than `count` if no further name is far enough.

    Of the names that are left, the first that is far enough comes next. A name that has narrower
    kinds in the world is left out: an armchair is a chair, but not the chair that is meant.
    """
    names = [name for name in names if fields.has(name) and not fields.has_kinds(name)]
    distances_m = {name: fields.distance_m(name) for name in names}
    cell = fields.plan.grid.cell_of(*start[:2])
    at_last_goal = np.zeros(fields.plan.grid.cells.shape, bool)  # at first: at the start
    at_last_goal[cell] = True
    goals: list[str] = []
    while len(goals) < count:
        far = (n for n in names if min_distance_m <= distances_m[n][at_last_goal].min() < math.inf)
        name = next(far, None)
        if name is None:
            break
        goals.append(name)
        names.remove(name)
        at_last_goal = fields.near(name)
    return tuple(goals)


class _CurrentLogger:
    """Sink that passes the results on to the ground-truth logger of the current goal."""

    def __init__(self) -> None:
        self.logger: GroundTruthLogger | None = None

    def tick(self, result: TickResult) -> None:
        if self.logger is not None:
            self.logger.tick(result)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def run_session(
    arm: ExperimentArm, episode: Episode, stop: threading.Event | None = None
) -> list[EpisodeOutcome]:
    """Run a session with one arm. An error gives "crashed" outcomes for the goals that are left.

    Raises:
        Stopped: `stop` was set.
    """
    outcomes: list[EpisodeOutcome] = []
    try:
        session = _Session(arm, episode, stop or threading.Event())
        try:
            outcomes.extend(session.run_goal(k) for k in range(1, len(episode.goals) + 1))
        finally:
            session.loop.close()
    except Stopped:
        raise
    except Exception as error:
        outcomes += crashed_outcomes(arm, episode, reason_of(error), len(outcomes))
    return outcomes


class _Session:
    """A running session: one robot and one service in one world."""

    def __init__(self, arm: ExperimentArm, episode: Episode, stop: threading.Event) -> None:
        self._arm, self._episode, self._stop = arm, episode, stop
        self._config = config = config_of(arm, episode)
        # A world whose objects move must not be the cached one.
        self._world = load_world(config) if episode.moved else world_list.load(config)
        warm_up_once(config)
        self._sink = _CurrentLogger()
        colour = wants_colour(config)
        self.loop = ClosedLoop(config, sinks=[self._sink], world=self._world, colour=colour)

    def run_goal(self, number: int) -> EpisodeOutcome:
        """Search for a goal, counted from 1, and judge it."""
        began_s, loop, config = time.monotonic(), self.loop, self._config
        if number > 1:
            self._begin_goal(number)
        goal, base = self._episode.goals[number - 1], truth_of(loop)  # base: at the goal's begin
        start = base.x_m, base.y_m, base.yaw_rad
        shortest_m = self._shortest_m(goal, base.x_m, base.y_m)
        part = replace(
            self._episode, id=self._episode.parts[number - 1], start=start, target=goal,
            shortest_m=shortest_m, goals=(),
        )  # fmt: skip
        self._sink.logger = logger = GroundTruthLogger(
            config, self._world, lambda stamp_ns: _counted_from(base, truth_of(loop))
        )
        step_to_end(loop, self._stop)
        latency = loop.service.latency.report()
        outcome = outcome_of(self._arm, part, config, self._world, logger, latency, began_s)
        if self._episode.moved:  # a comparison could not compute the distance left at first sight
            outcome = replace(outcome, first_sight_path_m=None)
        return replace(outcome, goal=number)

    def _begin_goal(self, number: int) -> None:
        """Move objects, forget if the arm forgets, and begin the mission of a goal."""
        loop, goals = self.loop, self._episode.goals
        now_ns = loop.drive.motion.stamp_ns
        if self._episode.moved:
            self._move_objects(number)
        if self._arm.forgets:
            loop.service.on_pose_jump(now_ns)
        mission = self._config.mission.model_copy(update=mission_for(goals[number - 1]))
        config = self._config.model_copy(update={"mission": mission})
        loop.service.begin(prepare_mission(config), now_ns)

    def _move_objects(self, number: int) -> None:
        if not isinstance(self._world, BoxWorld):
            raise UserError(
                f"--moved: objects of the world {self._world.name} cannot be moved; use houses "
                "(house, generated or ProcTHOR)"
            )
        pose = self.loop.drive.motion.pose
        rng = np.random.default_rng([number, *self._episode.id.encode()])
        radius_m = self._config.robot.radius_m
        rearrange(self._world, self._episode.moved, rng, pose, radius_m, self._episode.goals)
        forget_distances()

    def _shortest_m(self, goal: str, x_m: float, y_m: float) -> float:
        left_m = remaining_m(self._config, self._world, goal, x_m, y_m)
        if left_m is None:
            raise UserError(
                f"world {self._world.name}: no path to a {goal} from ({x_m:.2f}, {y_m:.2f}) m"
            )
        return round(left_m, 4)


def _counted_from(base: GroundTruth, truth: GroundTruth) -> GroundTruth:
    """Return the ground truth with path and contacts counted from an earlier one."""
    return truth._replace(
        path_m=truth.path_m - base.path_m,
        collisions=truth.collisions - base.collisions,
        person_contacts=truth.person_contacts - base.person_contacts,
    )
