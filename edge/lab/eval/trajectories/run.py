"""`edge eval trajectories`: run methods on the same episodes, except those already on file."""

from __future__ import annotations

import argparse
import logging
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

from pydantic import ValidationError

from edge.config import ConfigError, TasksConfig, WriterModel, load
from edge.config.explain import explain
from edge.errors import FileError, UnavailableError, UserError
from edge.host.signals import stop_on_signals
from edge.lab.eval.arms import digest_of
from edge.lab.eval.comparison import tables as comparison_tables
from edge.lab.eval.trajectories import pictures, tables
from edge.lab.eval.trajectories.episodes import TrajectoryEpisode, episodes
from edge.lab.eval.trajectories.methods import METHODS, methods_of, run_methods
from edge.lab.eval.trajectories.outcomes import (
    ResultsFolder,
    TrajectoryOutcome,
    facts_of,
    gather,
    outcome_of,
)
from edge.lab.eval.trial.scene_capture import detector_pipeline
from edge.lab.report import canvas
from edge.tasks.scene.pipeline import PerceptionPipeline
from edge.text import one_line

RERUN = "crashed"
"""Refusals with this cause are run again."""


def run_all(
    planned: Iterable[TrajectoryEpisode],
    names: Sequence[str],
    config: TasksConfig,
    folder: ResultsFolder,
    on_outcome: Callable[[TrajectoryEpisode, TrajectoryOutcome], None] = lambda *_: None,
    stop: threading.Event | None = None,
    seen_by: str = "",
) -> list[tuple[str, str, str]]:
    """Run methods on episodes. Outcomes on file are not run again; new ones are appended.

    `config` names the writer, and `seen_by` the source of the scenes' objects: "" if they are
    known, or come from labels. `stop` ends the run early, between two episodes.

    Returns:
        The keys of the outcomes.

    Raises:
        UnavailableError: the writer cannot run, or its server gives no answer to the first episode.
    """
    writer = ", by ".join(filter(None, (writer_of(config), seen_by)))
    keys: list[tuple[str, str, str]] = []
    is_first_question = isinstance(config.planner, WriterModel)
    for episode in planned:
        if stop is not None and stop.is_set():
            break
        possible = methods_of(config, episode.scene)
        episode_keys = [(episode.id, name, writer) for name in names if name in possible]
        known = folder.outcomes
        missing = [
            key[1]  # the method
            for key in episode_keys
            if key not in known or known[key].refused == RERUN
        ]
        if missing:
            results = run_methods(episode, missing, config)
            # A server that gives no answer at all ends the run before anything is saved.
            if is_first_question and all(r.refused == "no answer" for r in results.values()):
                raise UnavailableError(next(iter(results.values())).reason)
            is_first_question = False
            folder.add(facts_of(episode))
            for name in missing:
                outcome = outcome_of(episode, name, writer, results[name])
                folder.append(outcome)
                on_outcome(episode, outcome)
        keys += episode_keys
    return keys


def writer_of(config: TasksConfig) -> str:
    """Return the name of the writer for outcomes; a model's has a hash of its settings."""
    planner = config.planner
    if isinstance(planner, WriterModel):
        return f"{planner.model} {digest_of(config.model_dump(mode='json'))}"
    return planner.kind


# -- the command --------------------------------------------------------------------------------


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval trajectories`."""
    config = _config(args)
    names = _parse_methods(args.methods, config)
    logging.getLogger("edge").setLevel(logging.WARNING)
    folder = ResultsFolder(args.out)
    with _detector(args) as (pipeline, seen_by):
        keys = run_all(
            episodes(args.places, args.limit, pipeline), names, config, folder,
            lambda episode, outcome: print(_outcome_line(episode, outcome), flush=True),
            stop_on_signals(), seen_by,
        )  # fmt: skip
    results = gather(folder.facts.values(), [folder.outcomes[key] for key in keys])
    for table in tables.tables(results):
        print(f"\n{comparison_tables.text(table)}")
    try:
        paths = canvas.save_plots(pictures.figures(results), args.out, ("svg",))
    except FileError as error:  # the outcomes are saved: the next run makes only the pictures
        raise FileError(
            f"{error}; the tables above are complete; for the pictures, run again"
        ) from None
    for path in paths:
        print(path)
    return 0


@contextmanager
def _detector(args: argparse.Namespace) -> Iterator[tuple[PerceptionPipeline | None, str]]:
    """Yield the pipeline of `--detector`'s configuration, and its name with a hash of its settings.

    Without `--detector`, they are None and "".
    """
    if args.detector is None:
        yield None, ""
        return
    config = load(args.detector)
    settings = config.model_dump(mode="json", include={"perception", "tasks"})
    with detector_pipeline(config, ()) as (pipeline, name):
        yield pipeline, f"{name} {digest_of(settings)}"


def _config(args: argparse.Namespace) -> TasksConfig:
    """Return the settings of tasks from the options."""
    if args.url is None:
        if args.model is not None:
            raise UserError("--model: also give the URL of the model's server, with --url")
        return TasksConfig()
    planner = {"kind": "model", "url": args.url, "time_limit_s": args.time_limit,
               "max_attempts": args.rounds}  # fmt: skip
    if args.model is not None:
        planner["model"] = args.model
    try:
        return TasksConfig.model_validate({"planner": planner})
    except ValidationError as error:
        raise ConfigError(explain(error.errors()[0], "--url, --model", TasksConfig)) from None


def _parse_methods(wanted: str | None, config: TasksConfig) -> tuple[str, ...]:
    """Parse `--methods`; without it, return all methods that differ for the writer."""
    possible = methods_of(config)
    if wanted is None:
        return possible
    names = tuple(dict.fromkeys(name.strip() for name in wanted.split(";")))
    for name in names:
        if name in METHODS and name not in possible:
            raise UserError(
                f"--methods: {name}: without --url this is the same as ours; omit {name}, or give "
                "--url"
            )
        if name not in possible:
            raise UserError(
                f"--methods: no method {one_line(name)!r} (choices: {'; '.join(possible)})"
            )
    return names


def _outcome_line(episode: TrajectoryEpisode, outcome: TrajectoryOutcome) -> str:
    verdict = "ok  " if outcome.success else "FAIL"
    refusal = outcome.refused and f"{outcome.refused}: {outcome.reason}"
    return (
        f"{verdict} {outcome.method:18} {episode.world:15} NE {outcome.error_m:5.2f} m, "
        f"Fréchet {outcome.frechet_m:5.2f} m, NDTW {outcome.ndtw:.2f}, {outcome.contacts} contacts,"
        f" {outcome.seconds:.2f} s: {episode.task.instruction}{refusal and f' ({refusal})'}"
    )
