"""Models that choose directions, compared on the same lettered views, each in a process of its own.

What they choose is held against the FP32 model of their family and, in a simulated world, against
what is truly left to drive from each mark.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any, Union

import numpy as np

from edge import names
from edge.config import ChoiceOnnx
from edge.host import machine, resources
from edge.host.files import save
from edge.lab.bench.alone import run_alone
from edge.lab.bench.frames import Frames
from edge.lab.bench.variants import PROVIDERS, providers_here, runs_on
from edge.lab.eval import geodesic
from edge.perception.runtime.card_types import DirectionsCard
from edge.perception.runtime.cards import all_cards, how_to_get
from edge.perception.scoring.choice.question import Mark, Sighting, View, Ways
from edge.text import aligned
from edge.types import Observation

MEASURE = "edge.lab.bench.measure_choice"
REFERENCE = "fp32"
_AT = ((0.2, 0.65, 0.5, 2.0), (0.5, 0.6, 0.0, 4.0), (0.8, 0.65, -0.5, 3.0))
"""Marks that every view has: column and row as shares, bearing and distance."""
_SEEN = 5
_TARGETS = ("television", "bed", "sink", "sofa")
_VIEW_S, _LOAD_S = 60.0, 600.0
_HEADINGS = (
    "variant", "on", "ready, s", "ms: p50", "p95", "MB", "same choice", "mean |Δp|", "right",
)  # fmt: skip
_RIGHT_M = 0.5
"""A mark is right from which no more than this is left to drive than from the best."""
_ROBOT_M, _THERE_M, _STEP_M = 0.2, 1.0, 0.1
"""Radius of what drives; it ends so near the target; how finely a way is looked along."""

Row = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """What a measuring process does: ask a model about views."""

    choice: ChoiceOnnx
    views: list[View]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What such a process leaves.

    Attributes:
        took_ms: (n,) of each view, both questions.
        p: (n, marks + 2) float32: of the letters, of elsewhere, and the scene.
        load_s: until it was ready.
        memory_mb: what the process grew by.
    """

    took_ms: np.ndarray
    p: np.ndarray
    load_s: float
    memory_mb: float


Results = list[tuple[DirectionsCard, str, Union[Measured, str]]]


def families() -> list[str]:
    """Families that have a model that chooses directions."""
    return sorted({card.family for card in all_cards() if isinstance(card, DirectionsCard)})


def run(family: str, args: argparse.Namespace, pictures: Frames) -> int:
    """Compare the models of a family that has no other, print, keep; 1 when nothing could run.

    Raises:
        UserError: an option cannot be used.
    """
    rows = compare(family, args, pictures)
    print(machine.summary(machine.describe()))
    print(as_text(family, rows, pictures))
    path = _keep(family, rows)
    if args.json is not None:
        save(args.json, json.dumps(rows, indent=1).encode())
    print(f"kept in {path}")
    return 0 if any_ran(rows) else 1


def compare(family: str, args: argparse.Namespace, pictures: Frames) -> list[Row]:
    """A row for each of a family's models on each provider.

    Args:
        args: of the command line: `providers` and `threads`.

    Raises:
        UserError: an option cannot be used.
    """
    cards = [c for c in all_cards() if isinstance(c, DirectionsCard) and c.family == family]
    cards.sort(key=lambda card: (card.precision != REFERENCE, card.name))
    views = views_of(pictures)
    settings = ChoiceOnnx(card=family, time_limit_s=_VIEW_S)
    if args.threads is not None:
        settings = settings.model_copy(update={"threads": args.threads})
    results = [
        (card, on, _measured(card, settings.model_copy(update=_asked(card, on)), views))
        for on in providers_here(args.providers)
        for card in cards
        if on in ("cpu", "cuda") and runs_on(card, on)
    ]
    left_m = np.array(list(map(partial(_left_m, pictures), views))).reshape(-1, len(_AT))
    return [_row(*result, results, right_of(left_m)) for result in results]


def any_ran(rows: Sequence[Row]) -> bool:
    return any("why" not in row for row in rows)


def _asked(card: DirectionsCard, on: str) -> dict[str, object]:
    return {"card": card.name, "providers": PROVIDERS[on]}


def views_of(pictures: Frames) -> list[View]:
    """A view of each picture, with three letters, what is known to be in it, and a target that is
    not."""
    views = []
    for k, rgb in enumerate(pictures.rgb):
        h, w = rgb.shape[:2]
        marks = tuple(Mark(i, u * w, v * h, b, d) for i, (u, v, b, d) in enumerate(_AT))
        truth = None if pictures.truth is None else pictures.truth[k]
        labels = [] if truth is None else [pictures.labels[i] for i in truth.label[truth.counts]]
        seen = tuple(Sighting(label, 0.0, 1.0 + i) for i, label in enumerate(labels[:_SEEN]))
        turn = k % len(_TARGETS)
        targets = _TARGETS[turn:] + _TARGETS[:turn]
        unseen = (t for t in targets if not any(names.same(label, t) for label in labels))
        target = next(unseen, targets[0])
        straight_m = np.array([mark.distance_m for mark in marks], np.float32)
        ways = Ways(straight_m, np.ones_like(straight_m), np.zeros(3, np.float32))
        views.append(View(Observation(k, k, np.eye(4), rgb), target, marks, seen, ways=ways))
    return views


def _left_m(pictures: Frames, view: View) -> list[float]:
    """What is left to drive to the view's target from each of its marks, or from as far towards it
    as the floor is free; inf where nobody knows, or there is no way."""
    world = pictures.world
    things = [o for o in world.objects if names.same(o.label, view.target)] if world else []
    if not things:
        return [math.inf] * len(view.marks)
    plan, pose = world.plan, pictures.poses[view.observation.seq]
    field = geodesic.distance_field(plan, things, _ROBOT_M, _THERE_M)
    found = []
    for mark in view.marks:
        yaw_rad, left_m = pose.yaw_rad + mark.bearing_rad, math.inf
        for away_m in np.arange(0.0, mark.distance_m, _STEP_M):
            x_m = pose.x_m + away_m * math.cos(yaw_rad)
            y_m = pose.y_m + away_m * math.sin(yaw_rad)
            if math.isinf(here_m := geodesic.at(plan, field, x_m, y_m)):
                break
            left_m = here_m
        found.append(left_m)
    return found


def right_of(left_m: np.ndarray) -> np.ndarray:
    """Which marks are right, of the views in which not all are.

    Args:
        left_m: (n, m) metres left to drive from each mark.

    Returns:
        (n, m) bool; of a view that tells nothing, none.

    >>> right_of(np.array([[2.0, 2.4, 9.0], [3.0, 3.0, 3.0], [np.inf, np.inf, np.inf]])).tolist()
    [[True, True, False], [False, False, False], [False, False, False]]
    """
    least_m = left_m.min(axis=1, keepdims=True)
    right = np.isfinite(least_m) & (left_m <= least_m + _RIGHT_M)
    return right & ~right.all(axis=1, keepdims=True)


def _measured(card: DirectionsCard, settings: ChoiceOnnx, views: list[View]) -> Measured | str:
    """What was measured, or in one line why nothing was."""
    if not card.is_here():
        return f"not here: {how_to_get(card)}"
    return run_alone(MEASURE, Job(settings, views), _LOAD_S + _VIEW_S * len(views))


def _row(
    card: DirectionsCard, on: str, found: Measured | str, results: Results, right: np.ndarray
) -> Row:
    row: Row = {"name": card.name, "on": on}
    if isinstance(found, str):
        return {**row, "why": found}
    reference = next(
        (f for c, _, f in results if c.precision == REFERENCE and isinstance(f, Measured)), None
    )
    agreed = None if reference in (None, found) else agreement(reference.p, found.p)
    return {
        **row,
        "ms_p50": round(float(np.percentile(found.took_ms, 50)), 1),
        "ms_p95": round(float(np.percentile(found.took_ms, 95)), 1),
        "load_s": round(found.load_s, 1),
        "memory_mb": round(found.memory_mb),
        **(agreed or {}),
        **against_truth(right, found.p),
    }


def against_truth(right: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """How often the likeliest letter is a right one, and how often one at random is; nothing where
    no view tells.

    Args:
        right: as `right_of` returns it.
        p: as in `Measured`.

    >>> right = np.array([[True, False], [False, True], [False, False]])
    >>> against_truth(right, np.array([[0.7, 0.2, 0.1, 0.5], [0.6, 0.4, 0, 0.5], [1, 0, 0, 1]]))
    {'right': 0.5, 'at_random': 0.5, 'of_views': 2}
    """
    telling = right.any(axis=1)
    if not telling.any():
        return {}
    chosen = p[telling, : right.shape[1]].argmax(axis=1)
    hits = right[telling][np.arange(len(chosen)), chosen]
    return {
        "right": round(float(hits.mean()), 3),
        "at_random": round(float(right[telling].mean()), 3),
        "of_views": int(telling.sum()),
    }


def agreement(reference: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """How often the same letter (or elsewhere) is the likeliest, and how far shares differ.

    >>> agreement(np.array([[0.7, 0.3, 0.5]]), np.array([[0.6, 0.4, 0.5]]))
    {'same': 1.0, 'difference': 0.0667}
    """
    same = reference[:, :-1].argmax(axis=1) == p[:, :-1].argmax(axis=1)
    difference = np.abs(reference - p).mean()
    return {"same": round(float(same.mean()), 3), "difference": round(float(difference), 4)}


def as_text(family: str, rows: Sequence[Row], pictures: Frames) -> str:
    """The table; a variant without figures has why below it."""
    ran = [row for row in rows if "why" not in row]
    cells = [
        (
            row["name"], row["on"], row["load_s"], row["ms_p50"], row["ms_p95"], row["memory_mb"],
            row.get("same", "-"), row.get("difference", "-"), row.get("right", "-"),
        )
        for row in ran
    ]  # fmt: skip
    missing = [f"{row['name']} on {row['on']}: {row['why']}" for row in rows if "why" in row]
    views = f"{len(pictures.rgb)} views of {pictures.source}, {len(_AT)} letters each"
    told = next((row for row in ran if "right" in row), None)
    note = [] if told is None else [
        f"right: a letter from which the least is left to drive, in {told['of_views']} views "
        f"where not all are; at random {told['at_random']:.2f}"
    ]  # fmt: skip
    table = aligned([_HEADINGS, *cells], left=2)
    return "\n".join([f"{family}, directions: {views}", table, *missing, *note])


def _keep(family: str, rows: list[Row]) -> Path:
    stamp = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S")
    path = resources.cache_dir() / "bench" / f"{family}-{stamp}.json"
    save(path, json.dumps({"machine": machine.describe(), "rows": rows}, indent=1).encode())
    return path
