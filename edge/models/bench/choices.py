"""Models that choose directions, compared on the same lettered views, each in a process of its own.

What they choose is held against the FP32 model of their family; nobody knows what would be right.
"""

from __future__ import annotations

import argparse
import json
import pickle
import subprocess
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from edge.config import ChoiceOnnx, Config
from edge.host import machine, resources
from edge.host.children import python_module
from edge.host.files import save
from edge.host.private_folder import private_folder
from edge.models.bench import frames
from edge.models.bench.frames import Frames
from edge.models.bench.variants import PROVIDERS, providers_here
from edge.perception.card_types import ChoiceCard
from edge.perception.cards import all_cards, how_to_get
from edge.perception.choice.question import Mark, Sighting, View, Ways
from edge.text import aligned
from edge.types import Observation

MEASURE = python_module("edge.models.bench.measure_choice")
REFERENCE = "fp32"
_AT = ((0.2, 0.65, 0.5, 2.0), (0.5, 0.6, 0.0, 4.0), (0.8, 0.65, -0.5, 3.0))
"""Marks that every view has: column and row as shares, bearing and distance."""
_SEEN = 5
_TARGETS = ("television", "bed", "sink", "sofa")
_VIEW_S, _LOAD_S = 60.0, 600.0
_HEADINGS = ("variant", "on", "ready, s", "ms: p50", "p95", "MB", "same choice", "mean |Δp|")


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


def families() -> list[str]:
    """Families that have a model that chooses directions."""
    return sorted({card.family for card in all_cards() if isinstance(card, ChoiceCard)})


def run(args: argparse.Namespace, config: Config) -> int:
    """Compare a family's models, print, keep; 1 when nothing could run.

    Raises:
        UserError: an option, the configuration or the world cannot be used.
    """
    cards = [c for c in all_cards() if isinstance(c, ChoiceCard) and c.family == args.family]
    cards.sort(key=lambda card: (card.precision != REFERENCE, card.name))
    ons = [on for on in providers_here(args.providers) if on in ("cpu", "cuda")]
    if args.images is not None:
        pictures = frames.from_folder(args.images, args.frames)
    else:
        pictures = frames.from_world(config, args.frames, [])
    views = views_of(pictures)
    settings = ChoiceOnnx(card=args.family, time_limit_s=_VIEW_S)
    if args.threads is not None:
        settings = settings.model_copy(update={"threads": args.threads})
    rows = [
        (card, on, _measured(card, settings.model_copy(update=_asked(card, on)), views))
        for on in ons
        for card in cards
    ]
    report = [_row(card, on, found, rows) for card, on, found in rows]
    print(f"{args.family}: {len(views)} views of {pictures.source}, {len(_AT)} letters each")
    print(machine.summary(machine.describe()))
    print(as_text(report))
    path = _keep(args.family, report)
    if args.json is not None:
        save(args.json, json.dumps(report, indent=1).encode())
    print(f"kept in {path}")
    return 0 if any("ms_p50" in row for row in report) else 1


def _asked(card: ChoiceCard, on: str) -> dict[str, object]:
    return {"card": card.name, "providers": PROVIDERS[on]}


def views_of(pictures: Frames) -> list[View]:
    """A view of each picture, with three letters and what is known to be in it."""
    views = []
    for k, rgb in enumerate(pictures.rgb):
        h, w = rgb.shape[:2]
        marks = tuple(Mark(i, u * w, v * h, b, d) for i, (u, v, b, d) in enumerate(_AT))
        truth = None if pictures.truth is None else pictures.truth[k]
        labels = [] if truth is None else [pictures.labels[i] for i in truth.label[truth.counts]]
        seen = tuple(Sighting(label, 0.0, 1.0 + i) for i, label in enumerate(labels[:_SEEN]))
        target = _TARGETS[k % len(_TARGETS)]
        straight_m = np.array([mark.distance_m for mark in marks], np.float32)
        ways = Ways(straight_m, np.ones_like(straight_m), np.zeros(3, np.float32))
        views.append(View(Observation(k, k, np.eye(4), rgb), target, marks, seen, ways=ways))
    return views


def _measured(card: ChoiceCard, settings: ChoiceOnnx, views: list[View]) -> Measured | str:
    """What was measured, or in one line why nothing was."""
    if not card.is_here():
        return f"not here: {how_to_get(card)}"
    with private_folder("edge-bench-") as folder:
        job, out = folder / "job", folder / "out"
        job.write_bytes(pickle.dumps(Job(settings, views)))
        limit_s = _LOAD_S + _VIEW_S * len(views)
        try:
            done = subprocess.run(
                [*MEASURE, str(job), str(out)], stdout=subprocess.PIPE, text=True,
                errors="replace", check=False, timeout=limit_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"failed: not done after {limit_s:g} s"
        if done.returncode:
            said = [line for line in done.stdout.splitlines() if line.strip()]
            return f"failed: {said[-1] if said else f'exit code {done.returncode}'}"
        return pickle.loads(out.read_bytes())


def _row(
    card: ChoiceCard, on: str, found: Measured | str, rows: list[tuple[Any, str, Any]]
) -> dict[str, Any]:
    row: dict[str, Any] = {"name": card.name, "on": on}
    if isinstance(found, str):
        return {**row, "why": found}
    reference = next(
        (f for c, _, f in rows if c.precision == REFERENCE and isinstance(f, Measured)), None
    )
    agreed = None if reference in (None, found) else agreement(reference.p, found.p)
    return {
        **row,
        "ms_p50": round(float(np.percentile(found.took_ms, 50)), 1),
        "ms_p95": round(float(np.percentile(found.took_ms, 95)), 1),
        "load_s": round(found.load_s, 1),
        "memory_mb": round(found.memory_mb),
        **(agreed or {}),
    }


def agreement(reference: np.ndarray, p: np.ndarray) -> dict[str, float]:
    """How often the same letter (or elsewhere) is the likeliest, and how far shares differ.

    >>> agreement(np.array([[0.7, 0.3, 0.5]]), np.array([[0.6, 0.4, 0.5]]))
    {'same': 1.0, 'difference': 0.0667}
    """
    same = reference[:, :-1].argmax(axis=1) == p[:, :-1].argmax(axis=1)
    difference = np.abs(reference - p).mean()
    return {"same": round(float(same.mean()), 3), "difference": round(float(difference), 4)}


def as_text(report: list[dict[str, Any]]) -> str:
    """The table; a variant without figures has why below it."""
    ran = [row for row in report if "why" not in row]
    rows = [
        (
            row["name"], row["on"], row["load_s"], row["ms_p50"], row["ms_p95"], row["memory_mb"],
            row.get("same", "-"), row.get("difference", "-"),
        )
        for row in ran
    ]  # fmt: skip
    missing = [f"{row['name']} on {row['on']}: {row['why']}" for row in report if "why" in row]
    return "\n".join([aligned([_HEADINGS, *rows], left=2), *missing])


def _keep(family: str, report: list[dict[str, Any]]) -> Path:
    stamp = datetime.now(timezone.utc).strftime("%Y%m%d-%H%M%S")
    path = resources.cache_dir() / "bench" / f"{family}-{stamp}.json"
    save(path, json.dumps({"machine": machine.describe(), "rows": report}, indent=1).encode())
    return path
