"""Runs one episode with one arm, in this process and in one thread, and judges it."""

from __future__ import annotations

import threading
import time
from functools import lru_cache
from pathlib import Path

import numpy as np

from edge.config import Config, parse
from edge.errors import Stopped, UserError
from edge.lab.eval import geodesic, world_list
from edge.lab.eval.arms import LOCKSTEP, ExperimentArm, merged
from edge.lab.eval.closed_loop import ClosedLoop, wants_colour
from edge.lab.eval.episodes import Episode
from edge.lab.eval.ground_truth import GroundTruth, GroundTruthLogger, objects_meant_by
from edge.lab.eval.metrics import REACHED_M
from edge.lab.eval.outcome import EpisodeOutcome, crashed_outcome
from edge.lab.eval.questions import answers_of
from edge.lab.eval.true_rooms import in_room_of_kind
from edge.lab.report.page import write_report
from edge.lab.report.recorder import ReportRecorder
from edge.lab.sim.base import World
from edge.loop.latency import LatencyReport
from edge.loop.warmup import warm_up
from edge.memory import Site, site_of

TIME_LIMIT_FACTOR = 1.1  # factor on the mission's time limit after which every episode ends


def run_episode(
    arm: ExperimentArm,
    episode: Episode,
    page: Path | None = None,
    stop: threading.Event | None = None,
) -> EpisodeOutcome:
    """Run one episode with one arm. An error during the run gives a "crashed" outcome.

    `page` is a folder for a report of the run.

    Raises:
        Stopped: `stop` was set.
    """
    began_s = time.monotonic()
    try:
        config = config_of(arm, episode)
        world = world_list.load(config)
        logger, latency = _drive(config, world, episode, page, stop or threading.Event())
        return outcome_of(arm, episode, config, world, logger, latency, began_s)
    except Stopped:
        raise
    except Exception as error:
        return crashed_outcome(arm, episode, reason_of(error), time.monotonic() - began_s)


def reason_of(error: Exception) -> str:
    """Return the text of an error for `EpisodeOutcome.reason`."""
    return str(error) if isinstance(error, UserError) else repr(error)


def config_of(arm: ExperimentArm, episode: Episode) -> Config:
    """Return the configuration of an episode with an arm.

    It runs in lockstep, with every model in the service's process and on one thread, so that the
    result does not depend on real time.
    """
    data = merged(arm.base, episode.sensing, arm.settings, LOCKSTEP, episode.settings)
    data["sim"]["world"] = episode.world
    if data["perception"]["detector"].get("kind") == "onnx":
        data["perception"]["detector"]["threads"] = 1
    return parse(data, f"{arm.path}: arm {arm.name}")


def _drive(
    config: Config, world: World, episode: Episode, page: Path | None, stop: threading.Event
) -> tuple[GroundTruthLogger, LatencyReport]:
    """Run an episode to its end. Write a report if a folder is given.

    Raises:
        Stopped: the event was set before the end.
    """
    warm_up_once(config)
    site = site_of(episode.site) if episode.site else Site()
    keep_out_m = site.polygons_m("keep_out")
    # The logger is called only later, once `loop` exists.
    logger = GroundTruthLogger(config, world, lambda stamp_ns: truth_of(loop), keep_out_m)
    recorder = None if page is None else ReportRecorder(config)
    sinks = [logger] if recorder is None else [logger, recorder]
    colour = recorder is not None or wants_colour(config)
    loop = ClosedLoop(config, sinks=sinks, world=world, colour=colour, site=site)
    service = loop.service
    try:
        step_to_end(loop, stop)
        now_ns = loop.drive.motion.stamp_ns
        logger.answers = answers_of(service, world, episode.asks, now_ns)
        if page is not None and recorder is not None:
            write_report(recorder.record(service.result(), {}), page)
        return logger, service.latency.report()
    finally:
        loop.close()


def step_to_end(loop: ClosedLoop, stop: threading.Event) -> None:
    """Step until the mission has ended, or is overdue.

    Raises:
        Stopped: `stop` was set.
    """
    config = loop.config
    for _ in range(int(TIME_LIMIT_FACTOR * config.mission.time_limit_s / config.sim.step_s)):
        if loop.service.status.done:
            return
        if stop.is_set():
            raise Stopped("episode stopped by request")
        loop.step()


_warm_policies: set[str] = set()


def warm_up_once(config: Config) -> None:
    """Compile the loop's kernels, once a process and policy, so that no timed tick includes it."""
    policy = config.policy.model_dump_json()
    if policy not in _warm_policies:
        warm_up(config)
        _warm_policies.add(policy)


def truth_of(loop: ClosedLoop) -> GroundTruth:
    """Return the ground truth of this instant."""
    motion = loop.drive.motion
    where = motion.pose.x_m, motion.pose.y_m, motion.pose.yaw_rad
    ghost_s = None if loop.ghosts is None else loop.ghosts.longest_s
    return GroundTruth(
        *where, motion.path_m, motion.collisions, loop.rig.ids,
        person_contacts=motion.person_contacts, ghost_s=ghost_s,
    )  # fmt: skip


# -- the outcome ----------------------------------------------------------------------------------


def outcome_of(
    arm: ExperimentArm,
    episode: Episode,
    config: Config,
    world: World,
    logger: GroundTruthLogger,
    latency: LatencyReport,
    began_s: float,
) -> EpisodeOutcome:
    """Judge a finished run.

    Raises:
        Exception: the error that stopped the ground-truth logger. The run cannot be judged without
            it.
    """
    if logger.fault is not None:
        raise logger.fault
    status, now = logger.status, logger.now
    if status is None or now is None:
        raise UserError("the service got no image and pose from the simulator; see the log above")
    failure, sight = logger.failure(status.target), logger.first_sight()
    away_m = left_m = None
    if episode.target is not None:
        away_m = logger.distance_to_target_m(episode.target, now.x_m, now.y_m)
        left_m = remaining_m(config, world, episode.target, now.x_m, now.y_m)
    score = latency.stage("score")
    return EpisodeOutcome(
        episode.id, arm.name, arm.id, world.name, str(episode.world["kind"]),
        episode.target, episode.instruction, episode.start, episode.shortest_m,
        failure is None, _reason(logger, config), failure,
        path_m=now.path_m,
        elapsed_s=logger.seconds,
        wall_s=time.monotonic() - began_s,
        distance_m=away_m,
        left_m=left_m,
        collisions=now.collisions,
        person_contacts=now.person_contacts if config.sim.people else None,
        ghost_s=now.ghost_s,
        first_sight_s=None if sight is None else sight.seconds,
        first_sight_path_m=None if sight is None else sight.path_m,
        wrong_stops=len(logger.wrong_stops),
        views=logger.recall.views,
        detected=logger.recall.detected,
        false_confirmations=len(logger.false_confirmed),
        goals=len(logger.goals),
        tick_ms={key: getattr(latency.tick, f"{key}_ms") for key in ("p50", "p95", "max")},
        score_ms=score.p95_ms,
        trail=logger.trail,
        goal_xy=[[goal.pose.x_m, goal.pose.y_m, goal.kind] for goal in logger.goals],
        ways=episode.ways,
        zone_entries=logger.zone_entries,
        answers=logger.answers,
    )  # fmt: skip


def _reason(logger: GroundTruthLogger, config: Config) -> str:
    status = logger.status
    if status is None or not status.done:
        return f"no end after {TIME_LIMIT_FACTOR * config.mission.time_limit_s:g} s"
    for label, away_m in logger.wrong_stops[:1]:
        return f"declared reached {away_m:.1f} m from the nearest {label}"
    if status.phase == "reached" and len(logger.stops) == 1:
        return f"{status.reason} ({logger.stops[0][1]:.1f} m from it)"
    return status.reason


def remaining_m(config: Config, world: World, target: str, x_m: float, y_m: float) -> float | None:
    """Return the metres left to drive from a place to a target; None if there is no path.

    Call `forget_distances` after objects of the world have moved.
    """
    field = _distance_field(world, target, config.robot.radius_m)
    left_m = geodesic.value_at(world.plan, field, x_m, y_m)
    return left_m if np.isfinite(left_m) else None


@lru_cache(maxsize=8)
def _distance_field(world: World, target: str, radius_m: float) -> np.ndarray:
    if target in world.room_kinds:
        return geodesic.distance_to(world.plan, in_room_of_kind(world, target, radius_m), radius_m)
    return geodesic.distance_field(world.plan, objects_meant_by(world, target), radius_m, REACHED_M)


def forget_distances() -> None:
    """Forget the distance fields that `remaining_m` keeps."""
    _distance_field.cache_clear()
