"""Models that choose directions, compared on the same lettered views, each in a process of its own.

What they choose is held against the FP32 model of their family, and against the mark that is
nearest to the target in the image, where the target is known to be in sight.
"""

from __future__ import annotations

import argparse
import json
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
from edge.models.bench.alone import run_alone
from edge.models.bench.frames import Frames
from edge.models.bench.variants import PROVIDERS, providers_here, runs_on
from edge.perception.card_types import DirectionsCard
from edge.perception.cards import all_cards, how_to_get
from edge.perception.choice.question import Mark, Sighting, View
from edge.text import aligned
from edge.types import Observation

MEASURE = "edge.models.bench.measure_choice"
REFERENCE = "fp32"
_AT = ((0.2, 0.65, 0.5, 2.0), (0.5, 0.6, 0.0, 4.0), (0.8, 0.65, -0.5, 3.0))
"""Marks that every view has: column and row as shares, bearing and distance."""
_SEEN = 5
_TARGETS = ("television", "bed", "sink", "sofa")
_VIEW_S, _LOAD_S = 60.0, 600.0
_HEADINGS = (
    "variant", "on", "ready, s", "ms: p50", "p95", "MB", "same choice", "mean |Δp|", "right",
)  # fmt: skip
_NOWHERE = -1

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


def run(args: argparse.Namespace, pictures: Frames) -> int:
    """Compare the models of a family that has no other, print, keep; 1 when nothing could run.

    Raises:
        UserError: an option cannot be used.
    """
    rows = compare(args.family, args, pictures)
    print(machine.summary(machine.describe()))
    print(as_text(args.family, rows, pictures))
    path = _keep(args.family, rows)
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
    nearest = marks_at_targets(views, pictures)
    return [_row(*result, results, nearest) for result in results]


def any_ran(rows: Sequence[Row]) -> bool:
    return any("why" not in row for row in rows)


def _asked(card: DirectionsCard, on: str) -> dict[str, object]:
    return {"card": card.name, "providers": PROVIDERS[on]}


def views_of(pictures: Frames) -> list[View]:
    """A view of each picture, with three letters and what is known to be in it; where it can be,
    the target is in sight."""
    views = []
    for k, rgb in enumerate(pictures.rgb):
        h, w = rgb.shape[:2]
        marks = tuple(Mark(i, u * w, v * h, b, d) for i, (u, v, b, d) in enumerate(_AT))
        labels = [label for label, _ in _in_sight(pictures, k)]
        seen = tuple(Sighting(label, 0.0, 1.0 + i) for i, label in enumerate(labels[:_SEEN]))
        turn = k % len(_TARGETS)
        targets = _TARGETS[turn:] + _TARGETS[:turn]
        there = (t for t in targets if any(names.same(label, t) for label in labels))
        target = next(there, targets[0])
        views.append(View(Observation(k, k, np.eye(4), rgb), target, marks, seen))
    return views


def _in_sight(pictures: Frames, k: int) -> list[tuple[str, np.ndarray]]:
    """Label and box, (4,) xyxy_px, of everything that counts in a picture."""
    if pictures.truth is None:
        return []
    truth = pictures.truth[k]
    rows = zip(truth.label[truth.counts], truth.xyxy_px[truth.counts], strict=True)
    return [(pictures.labels[i], box) for i, box in rows]


def marks_at_targets(views: Sequence[View], pictures: Frames) -> np.ndarray:
    """(n,) int: of each view the mark whose column is nearest to the target's in the image, -1
    where no target is known to be in sight."""
    out = np.full(len(views), _NOWHERE)
    for k, view in enumerate(views):
        boxes = [box for label, box in _in_sight(pictures, k) if names.same(label, view.target)]
        if boxes:
            u_px = np.array(boxes)[:, [0, 2]].mean(axis=1)
            away_px = np.abs(np.array([mark.u_px for mark in view.marks])[:, None] - u_px)
            out[k] = away_px.min(axis=1).argmin()
    return out


def _measured(card: DirectionsCard, settings: ChoiceOnnx, views: list[View]) -> Measured | str:
    """What was measured, or in one line why nothing was."""
    if not card.is_here():
        return f"not here: {how_to_get(card)}"
    return run_alone(MEASURE, Job(settings, views), _LOAD_S + _VIEW_S * len(views))


def _row(
    card: DirectionsCard, on: str, found: Measured | str, results: Results, nearest: np.ndarray
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
        **right_marks(nearest, found.p),
    }


def right_marks(nearest: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """How often the likeliest letter is the one at the target, of the views that have it in sight;
    nothing where there is no such view.

    >>> right_marks(np.array([0, 1, -1]), np.array([[0.7, 0.3, 0.5], [0.6, 0.4, 0.5], [1, 0, 1]]))
    {'right': 0.5, 'in_sight': 2}
    """
    there = nearest != _NOWHERE
    if not there.any():
        return {}
    right = p[there, :-1].argmax(axis=1) == nearest[there]
    return {"right": round(float(right.mean()), 3), "in_sight": int(there.sum())}


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
    in_sight = max((row.get("in_sight", 0) for row in ran), default=0)
    views = f"{len(pictures.rgb)} views of {pictures.source}, {len(_AT)} letters each"
    title = f"{family}, directions: {views}"
    note = [f"right: the letter at the target, of {in_sight} views with it in sight"]
    return "\n".join([title, aligned([_HEADINGS, *cells], left=2), *missing, *note[: in_sight > 0]])


def _keep(family: str, rows: list[Row]) -> Path:
    stamp = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S")
    path = resources.cache_dir() / "bench" / f"{family}-{stamp}.json"
    save(path, json.dumps({"machine": machine.describe(), "rows": rows}, indent=1).encode())
    return path
