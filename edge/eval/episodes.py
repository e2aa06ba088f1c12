"""Find-the-object episodes in simulated time: SR, SPL, and why each failure failed.

Every episode is the real thing: simulated robot, reference controller and service in processes
of their own, over Zenoh, in lockstep.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from edge import names
from edge.bus import topics
from edge.bus.session import Ring
from edge.config import Config, Zenoh, load
from edge.errors import UserError
from edge.eval.metrics import spl, success_rate
from edge.host.children import python_module
from edge.host.signals import stop_on_signals
from edge.text import one_line

if TYPE_CHECKING:
    from edge.sim.base import World, WorldObject

REACHED_M = 1.0
_EPISODE_TIMEOUT_S = 1800.0
_LOOK_S = 0.5


@dataclass(frozen=True, slots=True)
class Episode:
    """A target to find and where to start from."""

    target: str
    start: tuple[float, float, float]
    shortest_m: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an episode ended, judged by the simulator's ground truth.

    Attributes:
        success: the service said `reached` and the robot stands within 1.0 m of the footprint
            of an object of that label.
        path_m: driven, by ground truth.
        distance_m: to the nearest such footprint at the end.
    """

    target: str
    start: tuple[float, float, float]
    success: bool
    reason: str
    shortest_m: float
    path_m: float
    elapsed_s: float
    distance_m: float
    bumps: int


def objects_of(world: World, target: str) -> list[WorldObject]:
    """The world's objects that a target's name means.

    Raises:
        UserError: there are none; lists what there is.
    """
    found = [o for o in world.objects if names.same(o.label, target)]
    if not found:
        labels = ", ".join(sorted({o.label for o in world.objects}))
        raise UserError(f"{world.name}: has no {target!r} (there are: {labels})")
    return found


def plan_episodes(
    config: Config, targets: list[str], starts: int, seed: int, min_distance_m: float
) -> list[Episode]:
    """`starts` seeded starts a target, each at least `min_distance_m` of driving away from it."""
    from edge.eval import geodesic
    from edge.host.bars import counted
    from edge.sim.base import free_poses
    from edge.sim.worlds import load_world

    world = load_world(config)
    episodes: list[Episode] = []
    for k, target in enumerate(counted("targets", targets)):
        wanted = objects_of(world, target)
        radius_m = config.robot.radius_m
        field = geodesic.distance_field(world.plan, wanted, radius_m, REACHED_M)
        poses = free_poses(world, 50 * starts, seed + 1000 * k, radius_m)
        found = []
        for pose in poses:
            shortest = geodesic.at(world.plan, field, pose.x_m, pose.y_m)
            if min_distance_m <= shortest < math.inf and len(found) < starts:
                start = (round(pose.x_m, 3), round(pose.y_m, 3), round(pose.yaw_rad, 3))
                found.append(Episode(target, start, shortest))
        if len(found) < starts:
            raise UserError(
                f"{world.name}: only {len(found)} of {starts} starts lie {min_distance_m:g} m "
                f"of driving from a {target}; ask for fewer or a smaller --min-distance"
            )
        episodes += found
    return episodes


def run_episode(
    config: Config,
    episode: Episode,
    report: Path | None = None,
    stop: threading.Event | None = None,
) -> Outcome:
    """One episode in this process and two children, until its end or until `stop` is set.

    Raises:
        Stopped: `stop` was set before the service was ready.
    """
    from edge.launch import children, on_a_free_port, open_service
    from edge.loop.runner import loop
    from edge.report.recorder import Recorder
    from edge.sim.worlds import load_world

    config = on_a_free_port(config).model_copy(
        update={
            "loop": config.loop.model_copy(update={"lockstep": True}),
            "mission": config.mission.model_copy(update={"target": episode.target}),
            "sim": config.sim.model_copy(update={"lockstep": True, "start": episode.start}),
        }
    )
    stop = stop or threading.Event()
    recorder = Recorder(config)
    with open_service(config, [recorder], stop=stop) as running:
        motion = TrueMotion(running.session, config.zenoh)
        with children(config, stop, ("sim", "--no-motion"), ("motion",)):
            watchdog = threading.Timer(_EPISODE_TIMEOUT_S, stop.set)
            watchdog.daemon = True
            watchdog.start()
            status = loop(running, stop, once=True, each=motion.update)
            watchdog.cancel()
            motion.settle()
        record = recorder.record(running.service.result(), running.source.counters)
    if report is not None:
        from edge.report.page import write_report

        write_report(record, report)
    x, y = motion.xy_m
    wanted = objects_of(load_world(config), episode.target)
    away = min(o.distance_m(x, y) for o in wanted)
    near = away <= REACHED_M
    reason = status.reason
    if status.phase == "reached" and not near:
        reason = f"declared reached {away:.1f} m from the nearest {episode.target}"
    elif not status.done:
        reason = f"no end after {_EPISODE_TIMEOUT_S:g} s"
    elif near:
        reason = f"{reason} ({away:.1f} m from it)"
    return Outcome(
        episode.target, episode.start, status.phase == "reached" and near, reason,
        episode.shortest_m, motion.path_m, status.elapsed_s, away, motion.bumps,
    )  # fmt: skip


class TrueMotion:
    """The simulator's own account of where the robot is."""

    def __init__(self, session: zenoh.Session, settings: Zenoh) -> None:
        self.xy_m = (math.nan, math.nan)
        self.path_m = 0.0
        self.bumps = 0
        self._ring = Ring(session, settings.key(topics.GROUND_TRUTH.key), 256)

    def update(self) -> None:
        """Take in what came since the last call."""
        for sample in self._ring.take():
            data = json.loads(sample.payload.to_bytes())
            self.xy_m = (data["pose"][0], data["pose"][1])
            self.path_m = data["path_m"]
            self.bumps = data["collisions"]

    def settle(self) -> None:
        """The last word of the simulator may still be on its way."""
        threading.Event().wait(0.3)
        self.update()


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval episodes`."""
    from edge.report.page import prepare

    config = load(args.config)
    report = prepare(args.report) if args.report else None
    stop = stop_on_signals()
    if args.episode:
        episode = json.loads(args.episode)
        outcome = run_episode(
            config, Episode(**{**episode, "start": tuple(episode["start"])}), report, stop
        )
        print(json.dumps(asdict(outcome)))
        return 0
    targets = [t.strip() for t in args.targets.split(",") if t.strip()]
    if not targets:
        raise UserError("--targets: name at least one, such as --targets sofa,bed")
    episodes = plan_episodes(config, targets, args.starts, args.seed, args.min_distance)
    outcomes = []
    for i, outcome in enumerate(_run_all(args.config, episodes, args.jobs, report, stop), start=1):
        outcomes.append(outcome)
        print(_line(i, len(episodes), outcome), flush=True)
        if report is not None:
            text = json.dumps([asdict(o) for o in outcomes], indent=1)
            (report / "results.json").write_text(text, encoding="utf-8")
    print(_table(outcomes))
    return 0


def _run_all(
    config: str, episodes: list[Episode], jobs: int, report: Path | None, stop: threading.Event
) -> Iterator[Outcome]:
    """Each episode in a process of its own: a crash fails that episode, not the evaluation.

    When `stop` is set, the running ones are stopped and left out, and no others begin.
    """

    def run(numbered: tuple[int, Episode]) -> Outcome | None:
        if stop.is_set():
            return None
        i, episode = numbered
        command = [*python_module("edge.cli"), "--log-level", "warning", "eval", "episodes"]
        command += [config, "--episode", json.dumps(asdict(episode))]
        if report is not None:
            command += ["--report", str(report / f"{i:02d}-{episode.target.replace(' ', '-')}")]
        code, out, err = _finish(command, stop)
        if stop.is_set():
            return None
        try:
            data = json.loads(out.strip().rpartition("\n")[2])
            return Outcome(**{**data, "start": tuple(data["start"])})
        except (ValueError, TypeError):
            last = (err.strip().splitlines() or ["no output"])[-1]
            return Outcome(
                episode.target, episode.start, False, f"crashed ({code}): {one_line(last)}",
                episode.shortest_m, 0.0, 0.0, math.inf, 0,
            )  # fmt: skip

    with ThreadPoolExecutor(jobs) as pool:
        for outcome in pool.map(run, enumerate(episodes, start=1)):
            if outcome is not None:
                yield outcome


def _finish(command: list[str], stop: threading.Event) -> tuple[int, str, str]:
    """Run a command to its end, or end it when `stop` is set: exit code, stdout, stderr."""
    pipe = subprocess.PIPE
    # A session of its own keeps the terminal's Ctrl-C for this process.
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    while True:
        try:
            out, err = process.communicate(timeout=_LOOK_S)
            return process.returncode, out, err
        except subprocess.TimeoutExpired:
            if stop.is_set():
                process.terminate()


def _line(i: int, n: int, o: Outcome) -> str:
    verdict = "ok  " if o.success else "FAIL"
    return (
        f"{i:3}/{n} {verdict} {o.target:12} {o.elapsed_s:6.1f} s  {o.path_m:5.1f} m driven, "
        f"{o.shortest_m:4.1f} m shortest, {o.bumps} bumps: {o.reason}"
    )


def _table(outcomes: list[Outcome]) -> str:
    """SR and SPL a target and over all."""
    groups = {
        t: [o for o in outcomes if o.target == t] for t in dict.fromkeys(o.target for o in outcomes)
    }
    groups["all"] = outcomes
    lines = [f"{'target':14}{'episodes':>9}{'SR':>7}{'SPL':>7}"]
    for name, group in groups.items():
        successes = [o.success for o in group]
        weighted = spl(successes, [o.shortest_m for o in group], [o.path_m for o in group])
        lines.append(f"{name:14}{len(group):9}{success_rate(successes):7.2f}{weighted:7.2f}")
    return "\n".join(lines)
