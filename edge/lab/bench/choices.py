"""Comparison of choice models (VLM frontier selection) on the same views.

A view is an image with marks, and a choice model picks one mark, or "elsewhere". Marks are letters
in the image, and the card of a choice model is a `DirectionsCard`. Each model runs in its own
process. A model's choice is compared with the FP32 model of its family. In a simulated world it is
also compared with the true remaining distance from each mark.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Union

import numpy as np

from edge import names
from edge.config import ChoiceOnnx
from edge.host import machine, resources
from edge.host.files import save
from edge.lab.bench.frames import BenchFrames
from edge.lab.bench.isolated import run_isolated
from edge.lab.bench.variants import PROVIDERS, providers_here, runs_on
from edge.lab.eval import geodesic
from edge.lab.sim.base import objects_named
from edge.perception.runtime.card_types import DirectionsCard
from edge.perception.runtime.cards import all_cards, install_hint
from edge.perception.scoring.choice.question import DetectedObject, Mark, MarkCosts, MarkedView
from edge.text import format_table
from edge.types import Observation

MEASURE = "edge.lab.bench.measure_choice"  # module that measures in its own process
REFERENCE = "fp32"  # precision of the model that others are compared with
_MARKS_AT = ((0.2, 0.65, 0.5, 2.0), (0.5, 0.6, 0.0, 4.0), (0.8, 0.65, -0.5, 3.0))
"""Marks of every view: column and row as shares of the image, bearing [rad], distance [m]."""
_SEEN = 5  # most objects that a question names as seen
_TARGETS = ("television", "bed", "sink", "sofa")  # of the questions, in turn
_VIEW_S, _LOAD_S = 60.0, 600.0  # time limits of one view, and of loading a model
_HEADINGS = (
    "variant", "on", "ready, s", "ms: p50", "p95", "MB", "same choice", "mean |Δp|", "right",
)  # fmt: skip
_CORRECT_WITHIN_M = 0.5
"""A mark is correct if the remaining distance from it is at most this much above the best mark's.
The table and the rows call correct choices "right"."""
_ROBOT_M = 0.2  # radius of the robot
_REACHED_M = 1.0  # distance from the target at which the robot stops
_STEP_M = 0.1  # step along the line to a mark

Row = dict[str, Any]
"""Figures of one model on one provider; `why` if there are none."""


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceJob:
    """Job of a measuring process: the views to show to one model.

    Attributes:
        choice: the model and how to run it.
        views: images with marks, and questions.
    """

    choice: ChoiceOnnx
    views: list[MarkedView]


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceMeasurement:
    """Result of a measuring process.

    Attributes:
        took_ms: (n,) time of each view, for preparing the image and for all answers.
        p: (n, marks + 2) float32, the answers to each view. Columns: the probability of each mark,
            then that of "elsewhere" (these sum to 1), then the scene's score, which is no choice
            (`FrontierChoice.scene`, 0 to 1).
        load_s: time until the model was ready.
        memory_mb: growth of the process's resident memory.
    """

    took_ms: np.ndarray
    p: np.ndarray
    load_s: float
    memory_mb: float


Results = list[tuple[DirectionsCard, str, Union[ChoiceMeasurement, str]]]
"""Each model, its provider, and the measurement or the reason why there is none."""


def families() -> list[str]:
    """Return the families that have a choice model."""
    return sorted({card.family for card in all_cards() if isinstance(card, DirectionsCard)})


def run(family: str, args: argparse.Namespace, pictures: BenchFrames) -> int:
    """Compare the choice models of a family without detectors, print the table and save it.

    Returns:
        The exit status: 0, or 1 if no model could run.
    """
    rows = compare(family, args, pictures)
    print(machine.summary(machine.describe()))
    print(as_text(family, rows, pictures))
    path = _save(family, rows)
    if args.json is not None:
        save(args.json, json.dumps(rows, indent=1).encode())
    print(f"saved to {path}")
    return 0 if any_ran(rows) else 1


def compare(family: str, args: argparse.Namespace, pictures: BenchFrames) -> list[Row]:
    """Return one row for each choice model of a family on each provider."""
    cards = [c for c in all_cards() if isinstance(c, DirectionsCard) and c.family == family]
    cards.sort(key=lambda card: (card.precision != REFERENCE, card.name))
    views = views_of(pictures)
    settings = ChoiceOnnx(card=family, time_limit_s=_VIEW_S)
    if args.threads is not None:
        settings = settings.model_copy(update={"threads": args.threads})
    results = [
        (card, on, _measure(card, on, settings, views))
        for on in providers_here(args.providers)
        for card in cards
        if on in ("cpu", "cuda") and runs_on(card, on)
    ]
    remaining_m = np.array([_remaining_m(pictures, view) for view in views])
    correct = correct_marks(remaining_m.reshape(-1, len(_MARKS_AT)))
    return [_row(*result, results, correct) for result in results]


def any_ran(rows: Sequence[Row]) -> bool:
    """Return True if at least one row has figures."""
    return any("why" not in row for row in rows)


def views_of(pictures: BenchFrames) -> list[MarkedView]:
    """Return one view of each image: its marks, the objects seen, and a target not in the image."""
    views = []
    for k, rgb in enumerate(pictures.rgb):
        h, w = rgb.shape[:2]
        marks = tuple(
            Mark(i, u * w, v * h, bearing_rad, away_m)
            for i, (u, v, bearing_rad, away_m) in enumerate(_MARKS_AT)
        )
        truth = None if pictures.truth is None else pictures.truth[k]
        # Names of the objects in the image that count.
        labels = [] if truth is None else [pictures.labels[i] for i in truth.label[truth.counts]]
        seen = tuple(DetectedObject(label, 0.0, 1.0 + i) for i, label in enumerate(labels[:_SEEN]))
        # Start with another target for each image; take the first one that is not in the image.
        turn = k % len(_TARGETS)
        targets = _TARGETS[turn:] + _TARGETS[:turn]
        unseen = (t for t in targets if not any(names.same_name(label, t) for label in labels))
        target = next(unseen, targets[0])
        straight_m = np.array([mark.distance_m for mark in marks], np.float32)
        # Without a map: straight distances, equal gains, and no frontiers without a mark.
        costs = MarkCosts(
            path_m=straight_m, gain_m2=np.ones_like(straight_m), others=np.zeros(3, np.float32)
        )
        views.append(
            MarkedView(Observation(k, k, np.eye(4), rgb), target, marks, seen, mark_costs=costs)
        )
    return views


def _remaining_m(pictures: BenchFrames, view: MarkedView) -> list[float]:
    """Return the true remaining distance [m] to the view's target, for each of its marks.

    The distance counts from the mark, or from the last free point on the straight line to it. It is
    inf if the world is unknown or there is no path.
    """
    world = pictures.world
    targets = objects_named(world, view.target) if world else []
    if not targets:
        return [math.inf] * len(view.marks)
    plan, pose = world.plan, pictures.poses[view.observation.seq]
    field = geodesic.distance_field(plan, targets, _ROBOT_M, _REACHED_M)
    found = []
    for mark in view.marks:
        yaw_rad, remaining_m = pose.yaw_rad + mark.bearing_rad, math.inf
        for away_m in np.arange(0.0, mark.distance_m, _STEP_M):
            x_m = pose.x_m + away_m * math.cos(yaw_rad)
            y_m = pose.y_m + away_m * math.sin(yaw_rad)
            if math.isinf(here_m := geodesic.value_at(plan, field, x_m, y_m)):
                break
            remaining_m = here_m
        found.append(remaining_m)
    return found


def correct_marks(remaining_m: np.ndarray) -> np.ndarray:
    """Return which marks are correct, in the views where not all of them are: (n, m) bool.

    `remaining_m` is the remaining distance from each mark, (n, m). A view in which the marks do not
    differ has no correct one.

    >>> correct_marks(np.array([[2.0, 2.4, 9.0], [3.0, 3.0, 3.0], [np.inf] * 3])).tolist()
    [[True, True, False], [False, False, False], [False, False, False]]
    """
    least_m = remaining_m.min(axis=1, keepdims=True)
    correct = np.isfinite(least_m) & (remaining_m <= least_m + _CORRECT_WITHIN_M)
    return correct & ~correct.all(axis=1, keepdims=True)


def _measure(
    card: DirectionsCard, on: str, settings: ChoiceOnnx, views: list[MarkedView]
) -> ChoiceMeasurement | str:
    """Return the measurement of a card, or one line of text that says why there is none."""
    if not card.is_here():
        return f"not here: {install_hint(card)}"
    settings = settings.model_copy(update={"card": card.name, "providers": PROVIDERS[on]})
    return run_isolated(MEASURE, ChoiceJob(settings, views), _LOAD_S + _VIEW_S * len(views))


def _row(
    card: DirectionsCard,
    on: str,
    found: ChoiceMeasurement | str,
    results: Results,
    correct: np.ndarray,
) -> Row:
    """Return the row of one of the results; another one is the reference.

    `correct` is as `correct_marks` returns it.
    """
    row: Row = {"name": card.name, "on": on}
    if isinstance(found, str):
        return {**row, "why": found}
    reference = next(
        (f for c, _, f in results if c.precision == REFERENCE and isinstance(f, ChoiceMeasurement)),
        None,
    )
    agreed = None if reference in (None, found) else agreement(reference.p, found.p)
    return {
        **row,
        "ms_p50": round(float(np.percentile(found.took_ms, 50)), 1),
        "ms_p95": round(float(np.percentile(found.took_ms, 95)), 1),
        "load_s": round(found.load_s, 1),
        "memory_mb": round(found.memory_mb),
        **(agreed or {}),
        **against_truth(correct, found.p),
    }


def against_truth(correct: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """Return the share of correct choices, and the share that a random choice would get.

    `correct` is as `correct_marks` returns it, and `p` as in `ChoiceMeasurement`.

    Returns:
        `right`, the share of correct choices; `at_random`, the same for a random choice; and
            `of_views`, the number of views with a correct and a wrong mark. Empty without any.

    >>> correct = np.array([[True, False], [False, True], [False, False]])
    >>> against_truth(correct, np.array([[0.7, 0.2, 0.1, 0.5], [0.6, 0.4, 0, 0.5], [1, 0, 0, 1]]))
    {'right': 0.5, 'at_random': 0.5, 'of_views': 2}
    """
    decided = correct.any(axis=1)
    if not decided.any():
        return {}
    chosen = p[decided, : correct.shape[1]].argmax(axis=1)  # the best mark; not "elsewhere"
    hits = correct[decided][np.arange(len(chosen)), chosen]
    return {
        "right": round(float(hits.mean()), 3),
        "at_random": round(float(correct[decided].mean()), 3),
        "of_views": int(decided.sum()),
    }


def agreement(reference: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """Compare the answers of a model with those of the reference, both as `ChoiceMeasurement.p`.

    Returns:
        `same`, the share of views with the same choice (a mark or "elsewhere"), and `difference`,
            the mean absolute difference of all columns.

    >>> agreement(np.array([[0.7, 0.3, 0.5]]), np.array([[0.6, 0.4, 0.5]]))
    {'same': 1.0, 'difference': 0.0667}
    """
    same = reference[:, :-1].argmax(axis=1) == p[:, :-1].argmax(axis=1)
    difference = np.abs(reference - p).mean()
    return {"same": round(float(same.mean()), 3), "difference": round(float(difference), 4)}


def as_text(family: str, rows: Sequence[Row], pictures: BenchFrames) -> str:
    """Return the table; below it, the reason for each variant without figures."""
    ran = [row for row in rows if "why" not in row]
    cells = [
        (
            row["name"], row["on"], row["load_s"], row["ms_p50"], row["ms_p95"], row["memory_mb"],
            row.get("same", "-"), row.get("difference", "-"), row.get("right", "-"),
        )
        for row in ran
    ]  # fmt: skip
    missing = [f"{row['name']} on {row['on']}: {row['why']}" for row in rows if "why" in row]
    views = f"{len(pictures.rgb)} views of {pictures.source}, {len(_MARKS_AT)} letters each"
    scored = next((row for row in ran if "right" in row), None)
    note = [] if scored is None else [
        f"right: a letter with the shortest remaining path, in {scored['of_views']} views "
        f"where the letters differ; by chance {scored['at_random']:.2f}"
    ]  # fmt: skip
    table = format_table([_HEADINGS, *cells], left=2)
    return "\n".join([f"{family}, directions: {views}", table, *missing, *note])


def _save(family: str, rows: list[Row]) -> Path:
    """Write the rows into the cache; return the path."""
    stamp = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S")
    path = resources.cache_dir() / "bench" / f"{family}-{stamp}.json"
    save(path, json.dumps({"machine": machine.describe(), "rows": rows}, indent=1).encode())
    return path
