"""`edge eval episodes`: run experiment arms on the same episodes, except those already on file."""

from __future__ import annotations

import argparse
import logging
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from edge.config import Config, load
from edge.errors import UserError
from edge.host.signals import stop_on_signals
from edge.lab.eval import arms as experiment_arms
from edge.lab.eval import episodes as eps
from edge.lab.eval import world_list
from edge.lab.eval.arms import ExperimentArm
from edge.lab.eval.comparison.run import EPISODES_NAME, summary_text
from edge.lab.eval.episodes import Episode
from edge.lab.eval.outcome import EpisodeOutcome, OutcomeFile
from edge.lab.eval.questions import plan_questions
from edge.lab.eval.sessions import plan_sessions
from edge.lab.eval.workers import EpisodeJob, outcomes_of
from edge.lab.eval.zones import with_zones
from edge.lab.report.page import prepare
from edge.memory import RECOGNISED_KINDS, ROOM_KINDS
from edge.names import canonical
from edge.perception.embedding.text import find_vocabulary, load_vocabulary

TEXTURED_WORLDS, TEXTURED_PER_WORLD = "furnished[1000:1125]", 4  # of `edge eval textured`
DEFAULT_TARGETS = "trash can,sofa,chair,bed,desk"  # without `--targets` and `--worlds`

OnOutcome = Callable[[int, int, EpisodeOutcome], None]
"""Called with each new outcome: its number, the total number, and the outcome.

Both numbers include the outcomes that are already on file.
"""


def run_all(
    arms: Sequence[ExperimentArm],
    episodes: Sequence[Episode],
    out: Path | None = None,
    *,
    workers: int = 1,
    pages: Path | None = None,
    on_outcome: OnOutcome = lambda number, total, outcome: None,
    stop: threading.Event | None = None,
) -> list[EpisodeOutcome]:
    """Run every arm on every episode. Outcomes go to the folder `out` as they come.

    Outcomes that are there are used again, except those of crashed episodes and of other
    configurations. `workers` is the number of processes that run episodes; 1: only this one.
    `pages` is a folder for a report of each episode. `stop` ends the run early.

    Returns:
        Outcomes in the order of episodes and arms; fewer if the run was stopped early.
    """
    file = None if out is None else OutcomeFile(out)
    known = {} if file is None else file.known
    if out is not None:
        _save_new(out / EPISODES_NAME, episodes)
    usable = {key: o for key, o in known.items() if o.failure != "crashed"}
    pairs = [(episode, arm) for episode in episodes for arm in arms]
    # An episode has one outcome, a session one for each goal: its `parts`.
    keys = [(part, arm.id) for episode, arm in pairs for part in episode.parts]
    jobs = [
        EpisodeJob(arm, episode, pages and pages / f"{episode.id.replace('/', '-')}-{arm.name}")
        for episode, arm in pairs
        if any((part, arm.id) not in usable for part in episode.parts)
    ]
    done = len(keys) - sum(len(job.episode.parts) for job in jobs)
    outcomes = outcomes_of(jobs, workers, stop or threading.Event())
    for number, outcome in enumerate(outcomes, start=done + 1):
        if file is not None:
            file.append(outcome)
        usable[outcome.key] = outcome
        on_outcome(number, len(keys), outcome)
    return [usable[key] for key in keys if key in usable]


def count_outdated(arms: Sequence[ExperimentArm], out: Path) -> dict[str, int]:
    """Count the outcomes in a folder whose arm has the same name but other settings, by name."""
    ids = {arm.name: arm.id for arm in arms}
    counts: dict[str, int] = {}
    for outcome in OutcomeFile(out).known.values():
        if outcome.arm_id != ids.get(outcome.arm, outcome.arm_id):
            counts[outcome.arm] = counts.get(outcome.arm, 0) + 1
    return counts


def _save_new(path: Path, episodes: Sequence[Episode]) -> None:
    """Add the episodes to a folder's file of episodes, if they are not there yet."""
    known = eps.read(path) if path.exists() else []
    ids = {episode.id for episode in known}
    new = [episode for episode in episodes if episode.id not in ids]
    if new:
        eps.write(path, [*known, *new])


# -- the command ----------------------------------------------------------------------------------


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval episodes`."""
    if args.report is not None:
        prepare(args.report)
    config = load(args.config)
    arms = experiment_arms.make_arms(config, _arm_settings(args))
    episodes = _episodes(config, args)
    if any(episode.goals for episode in episodes):
        if args.report:
            raise UserError("--report: not possible with sessions (--goals); omit it")
        arms = experiment_arms.with_and_without_memory(arms)
    if args.plan is not None:
        eps.write(args.plan, episodes)
        print(f"{args.plan}: {len(episodes)} episodes")
        return 0
    out = args.out or args.report
    if out is not None:
        for name, count in count_outdated(arms, out).items():
            print(
                f"arm {name}: its settings have changed, so {count} earlier outcomes are not used"
            )
    logging.getLogger("edge").setLevel(logging.WARNING)  # each episode logs its mission
    outcomes = run_all(
        arms, episodes, out, workers=args.workers, pages=args.report,
        on_outcome=lambda *news: print(_outcome_line(*news), flush=True),
        stop=stop_on_signals(),
    )  # fmt: skip
    print(f"\n{summary_text(outcomes)}")
    return 0


def textured(args: argparse.Namespace) -> int:
    """Handle `edge eval textured`: `run` with other defaults."""
    if args.worlds is None and args.episodes is None:
        args.worlds = [TEXTURED_WORLDS]
        args.per_world = args.per_world or TEXTURED_PER_WORLD
        args.targets = args.targets or "vocabulary"
    if args.plan is None:
        args.out = args.out or args.report or Path("textured")
    return run(args)


def _arm_settings(args: argparse.Namespace) -> dict[str, experiment_arms.Data]:
    """Return the settings of each arm of `--arms` and `--arm`, by name."""
    by_name = {} if args.arms is None else experiment_arms.read_arms(args.arms)
    for words in args.arm or ():
        name, settings = experiment_arms.parse_arm(words)
        if name in by_name:
            raise UserError(
                f"--arm {name}: two arms have this name; choose another for one of them"
            )
        by_name[name] = settings
    return by_name


def _episodes(config: Config, args: argparse.Namespace) -> list[Episode]:
    """Read or plan the episodes that the options ask for."""
    if args.episodes is not None:
        return eps.read(args.episodes)[: args.limit]
    worlds = world_list.world_sections(args.worlds or ())
    targets = _targets(args.targets or ("common" if worlds else DEFAULT_TARGETS))
    if (args.missions or args.ask) and (rooms := ROOM_KINDS.keys() & targets):
        raise UserError(
            f"--targets: {', '.join(sorted(rooms))}: --missions and --ask take no rooms; omit them"
        )
    if not targets:
        raise UserError("--targets: got no name; give at least one, such as --targets sofa,bed")
    given, seed, least_m = (config, worlds, targets), args.seed, args.min_distance
    limit = args.limit
    if args.goals is not None:
        planned = plan_sessions(*given, args.goals, seed, least_m, args.moved, limit)
    elif args.ask:
        planned = plan_questions(*given, seed, limit)
    elif args.missions is not None:
        planned = eps.plan_missions(*given, args.missions, seed, least_m, limit)
    else:
        of_world = args.per_world, args.min_size
        planned = eps.plan(*given, args.starts, seed, least_m, *of_world, limit)
    return with_zones(config, planned, args.seed) if args.zones else planned


def _targets(asked: str) -> list[str]:
    """Return the names of `--targets`, each once."""
    found: list[str] = []
    for name in map(str.strip, asked.split(",")):
        if name == "common":
            found += eps.COMMON_TARGETS
        elif name == "rooms":
            found += RECOGNISED_KINDS
        elif name == "vocabulary":
            found += map(canonical, load_vocabulary(find_vocabulary(None))[0])
        elif name:
            found.append(name)
    return list(dict.fromkeys(found))


def _outcome_line(number: int, total: int, o: EpisodeOutcome) -> str:
    verdict = "ok  " if o.success else "FAIL"
    return (
        f"{number:3}/{total} {verdict} {o.arm:12} {o.world:18} "
        f"{o.instruction or o.target:12} {o.elapsed_s:6.1f} s, {o.path_m:5.1f} m driven, "
        f"{o.shortest_m:4.1f} m shortest, {o.collisions} collisions, {o.wall_s:.1f} s real time: "
        f"{o.reason}"
    )
