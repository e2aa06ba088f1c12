"""Where the figures go: a JSON file in the cache, and the cards."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import yaml

from edge.errors import FileError, UserError
from edge.host import machine, resources
from edge.host.files import write_atomically
from edge.models.bench.variants import RUNTIMES
from edge.perception.cards import card_path

_CARD_WIDTH = 110


def keep(report: dict[str, Any], also: Path | None) -> str:
    """Write the report into the cache, and to another file if one is named; where it is.

    Raises:
        UserError: it cannot be written there.
    """
    stamp = report["date"][:19].replace(":", "").replace("-", "").replace("T", "-")
    paths = [resources.cache_dir() / "bench" / f"{report['family']}-{stamp}.json"]
    paths += [also] if also is not None else []
    text = json.dumps(report, indent=1)
    for path in paths:
        _replace(path, text)
    return " and ".join(map(str, paths))


def update_cards(report: dict[str, Any]) -> Iterator[Path]:
    """Write the figures of each variant that ran into its card, in place of older ones of the
    same machine, GPU and provider; the cards that were written.

    Raises:
        UserError: when the others are written, for the first card that cannot be, as those of an
            installed package.
    """
    ran = [row for row in report["rows"] if row["state"] == "ran"]
    refused = None
    for name in dict.fromkeys(row["name"] for row in ran):
        path = card_path(name)
        try:
            _update_card(path, report, [row for row in ran if row["name"] == name])
        except UserError as error:
            refused = refused or error
        else:
            yield path
    if refused is not None:
        raise UserError(f"{refused}; the figures are in the JSON file alone")


def _update_card(path: Path, report: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """The card keeps its remarks at the top and the order of its keys."""
    text = path.read_text(encoding="utf-8")
    card = yaml.safe_load(text)
    for row in rows:
        key = f"{row['on']} of {machine.short_name(report['machine'], row['gpu'])}"
        card["measured"] = {**card.get("measured", {}), key: card_figures(report, row)}
    remarks = takewhile(lambda line: line.startswith("#"), text.splitlines(keepends=True))
    body = yaml.safe_dump(card, sort_keys=False, width=_CARD_WIDTH)
    _replace(path, "".join(remarks) + body)


def card_figures(report: dict[str, Any], row: dict[str, Any]) -> dict[str, float | int | str]:
    """The part of a report that a card keeps of one row: flat, without what is not known.

    `file` tells which file was measured, as cards of models that are made here have no hash;
    `others_cores` how busy other processes were meanwhile, which lengthens times.
    """
    times, frames = row["latency_ms"], report["frames"]
    agreement, truth = row["agreement"] or {}, row["truth"] or {}
    h, w = frames["hw"][0]
    found = {
        "date": report["date"][:10],
        "file": row["sha256"][:12],
        "gpu": row["gpu"],
        "runtime": ", ".join(f"{r} {report['machine'].get(r, '?')}" for r in RUNTIMES[row["on"]]),
        "threads": report["threads"] if row["on"] == "cpu" else None,
        "frames": f"{frames['count']} of {w}x{h} px, {frames['source']}",
        "prompts": len(report["prompts"]),
        **{f"{stage}_ms": times[stage]["p50"] for stage in ("pre", "session", "post")},
        "all_p50_ms": times["all"]["p50"],
        "all_p95_ms": times["all"]["p95"],
        "others_cores": row["others_cores"],
        "memory_mb": row["memory_mb"],
        "gpu_memory_mb": row["gpu_memory_mb"],
        "tau_det": report["tau_det"],
        "fp32_recall": agreement.get("recall"),
        "fp32_precision": agreement.get("precision"),
        "fp32_score_error": agreement.get("score_error"),
        "recall": truth.get("recall"),
        "precision": truth.get("precision"),
    }
    return {key: value for key, value in found.items() if value is not None}


def _replace(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from None
