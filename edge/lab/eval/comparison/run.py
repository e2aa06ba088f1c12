"""`edge eval episodes --compare`: tables and one page of a folder of outcomes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from edge.config import Config, parse
from edge.errors import UserError
from edge.host.files import save
from edge.host.progress import with_progress
from edge.lab.eval import episodes, world_list
from edge.lab.eval.arms import merged
from edge.lab.eval.comparison import page, tables, worlds
from edge.lab.eval.comparison.outcomes import Outcomes, baseline_of, gather
from edge.lab.eval.comparison.statistics import Comparison, compare
from edge.lab.eval.intervals import intervals_note
from edge.lab.eval.outcome import OUTCOMES_NAME, EpisodeOutcome, read_outcomes
from edge.lab.report.recorder import machine
from edge.text import one_line

EPISODES_NAME = "episodes.jsonl"  # in the folder of the outcomes
JSON_NAME, PAGE_NAME = "results.json", "comparison.html"


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval episodes --compare`."""
    comparison, drawings = compare_folder(args.compare, args.baseline)
    print(text(comparison))
    content = {
        JSON_NAME: tables.to_json(comparison),
        PAGE_NAME: page.html(comparison, drawings, args.compare.resolve().name, machine()).encode(),
    }
    for name, data in content.items():
        save(args.compare / name, data)
    print("\n".join(map(str, ["", *(args.compare / name for name in content)])))
    return 0


def compare_folder(
    folder: Path, baseline: str | None = None
) -> tuple[Comparison, dict[str, worlds.FloorPlanDrawing]]:
    """Compare the outcomes of a folder; return the comparison, and drawings by world.

    Raises:
        UserError: there are no outcomes, or no such arm; or a file cannot be read.
    """
    path = folder / OUTCOMES_NAME
    found = read_outcomes(path)
    if not found:
        raise UserError(f"{path}: has no outcomes; `edge eval episodes --out {folder}` writes them")
    outcomes = gather(found)
    baseline_of(outcomes, baseline)  # check the name before the worlds are loaded
    left_m, drawings = world_data(outcomes, configs_of(folder / EPISODES_NAME, outcomes))
    return compare(outcomes, baseline, left_m), drawings


def text(comparison: Comparison) -> str:
    """Return all tables for a terminal, with notes on intervals and on ignored outcomes."""
    if not comparison.outcomes.arms:
        return "no outcomes"
    parts = [tables.text(table) for table in tables.tables(comparison)]
    parts.append(intervals_note(comparison.outcomes.world))
    if comparison.outcomes.n_ignored:
        parts.append(
            f"{comparison.outcomes.n_ignored} older outcomes are ignored: earlier settings of an "
            "arm, or run again since"
        )
    return "\n\n".join(parts)


def summary_text(outcomes: Iterable[EpisodeOutcome]) -> str:
    """Return the text that is printed at the end of a run of episodes."""
    return text(compare(gather(outcomes)))


def configs_of(path: Path, outcomes: Outcomes) -> dict[str, Config]:
    """Read, by world, the configuration that loads it, from a file of episodes."""
    configs: dict[str, Config] = {}
    index = {name: e for e, name in enumerate(outcomes.episodes)}
    for episode in episodes.read(path):
        e = next((index[part] for part in episode.parts if part in index), None)
        if e is not None and str(outcomes.world[e]) not in configs:
            world_section = {
                "perception": {"detector": {"kind": "sim"}},
                "sim": {"world": episode.world},
            }
            data = merged(episode.sensing, world_section)
            configs[str(outcomes.world[e])] = parse(data, f"{path}: {one_line(episode.id)}")
    return configs


def world_data(
    outcomes: Outcomes, configs: Mapping[str, Config]
) -> tuple[np.ndarray, dict[str, worlds.FloorPlanDrawing]]:
    """Load the worlds of outcomes.

    Returns:
        (A, E) metres left to drive when the target was first seen, NaN if unknown; and drawings by
        world.
    """
    left_m = np.full(outcomes.ran.shape, np.nan)
    drawings = {}
    for name in with_progress("worlds", list(configs)):
        world, radius_m = world_list.load(configs[name]), configs[name].robot.radius_m
        inside = np.flatnonzero(outcomes.world == name).tolist()
        targets = sorted({str(outcomes.target[e]) for e in inside} - {""})
        drawings[name] = worlds.draw(world, targets, radius_m)
        worlds.fill_left_at_sight_m(world, inside, outcomes, radius_m, left_m)
    return left_m, drawings
