"""Output of `edge bench --models`: a table on the terminal, a JSON file, and the model cards."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import yaml

from edge.config.yaml_text import parse_yaml
from edge.errors import UserError
from edge.host import machine, resources
from edge.host.files import save
from edge.lab.bench.variants import RUNTIMES
from edge.perception.runtime.cards import card_path
from edge.perception.runtime.health import WHY_INVALID
from edge.text import format_table

Report = dict[str, Any]
"""Figures of a family's variants, as `compare.compare` returns them."""
_CARD_WIDTH = 110  # of a line in a model card

_HEADINGS = (
    "variant", "on", "pre", "session", "post", "all", "MB", "fp32: recall", "prec.", "score",
    "truth: recall", "prec.",
)  # fmt: skip
_WIDTH = 110  # of a line of the header, in characters
_QUIET_CORES = 0.2
"""Below this load, other processes do not change the times much."""


def as_text(report: Report) -> str:
    """Return header, table and footnotes of one family's report."""
    return "\n".join([*_header(report), "", *_rows(report), *_footnotes(report)])


def _header(report: Report) -> list[str]:
    """Return lines about the frames, the prompts, the settings and the machine."""
    frames, prompts = report["frames"], report["prompts"]
    sizes = ", ".join(f"{w}x{h}" for h, w in frames["hw"])
    # Objects that count, see `boxes.GroundTruthBoxes`.
    objects = f", {frames['things']} objects in them" if frames["things"] is not None else ""
    unknown = report["unknown_labels"]
    lacking = f" (no word for {', '.join(unknown)})" if unknown else ""
    lines = [
        f"{report['family']}: {frames['count']} frames of {sizes} px ({frames['source']}){objects}",
        f"{len(prompts)} prompts{lacking}",
        f"boxes above {report['tau_det']:g}; {_threads(report['threads'])} on the CPU",
        machine.summary(report["machine"]),
    ]
    return [textwrap.fill(line, _WIDTH, subsequent_indent="  ") for line in lines]


def _threads(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _rows(report: Report) -> list[str]:
    """Return the table of the variants, and a line for each that has no figures."""
    rows = [_cells(row, report["family"]) for row in report["rows"] if row["state"] == "ran"]
    missing = [
        f"{row['name']} on {row['on']}: {row['why']}"
        for row in report["rows"]
        if row["state"] != "ran"
    ]
    times = "times in ms: p50 (p95); boxes against those of FP32, and against truth"
    return [times, format_table([_HEADINGS, *rows], left=2), *missing]


def _cells(row: dict[str, Any], family: str) -> tuple[str, ...]:
    times = [f"{t['p50']:.1f} ({t['p95']:.1f})" for t in row["latency_ms"].values()]
    fp32, truth = row["agreement"] or {}, row["truth"] or {}
    shares = [fp32.get("recall"), fp32.get("precision"), fp32.get("score_error")]
    shares += [truth.get("recall"), truth.get("precision")]
    memory = f"{row['memory_mb']:.0f}"
    if (gpu := row["gpu_memory_mb"]) is not None:
        memory += f"+{gpu:.0f}"
    name = row["name"].removeprefix(f"{family}-")
    return (name, row["on"], *times, memory, *("-" if s is None else f"{s:.2f}" for s in shares))


def _footnotes(report: Report) -> list[str]:
    """Return remarks on the load of the machine, the memory, and invalid boxes."""
    ran = [row for row in report["rows"] if row["state"] == "ran"]
    lines = []
    others = max((row["others_cores"] or 0.0 for row in ran), default=0.0)
    if others > _QUIET_CORES:
        lines.append(
            f"other processes kept up to {others:.1f} of {report['machine']['cores']} cores busy: "
            "the times are shorter on an idle machine"
        )
    if any(row["gpu_memory_mb"] is not None for row in ran):
        lines.append("MB: growth of the process + growth of the GPU memory in use")
    for row in ran:
        if row["invalid_boxes"]:
            lines.append(
                f"{row['name']} on {row['on']}: {row['invalid_boxes']} boxes {WHY_INVALID}"
            )
    return lines


def save_report(report: Report, also: Path | None) -> str:
    """Write the report into the cache, and also to `also` if given; return the paths as text."""
    stamp = report["date"][:19].replace(":", "").replace("-", "").replace("T", "-")
    paths = [resources.cache_dir() / "bench" / f"{report['family']}-{stamp}.json"]
    paths += [also] if also is not None else []
    text = json.dumps(report, indent=1)
    for path in paths:
        save(path, text.encode())
    return " and ".join(map(str, paths))


def update_cards(report: Report) -> Iterator[Path]:
    """Write the figures of each variant that ran into its card.

    They replace older figures of the same machine, GPU and provider.

    Yields:
        The paths of the written cards.

    Raises:
        UserError: a card cannot be written, such as one of an installed package. The other cards
            are written first.
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
        raise UserError(
            f"{refused}; the measured times are only in this output and the --json file"
        )


def _update_card(path: Path, report: Report, rows: list[dict[str, Any]]) -> None:
    """Write the figures; keep the comments at the top and the order of the keys."""
    text = path.read_text(encoding="utf-8")
    card = parse_yaml(text)
    for row in rows:
        key = f"{row['on']} of {machine.short_name(report['machine'], row['gpu'])}"
        card["measured"] = {**card.get("measured", {}), key: card_figures(report, row)}
    remarks = takewhile(lambda line: line.startswith("#"), text.splitlines(keepends=True))
    body = yaml.safe_dump(card, sort_keys=False, width=_CARD_WIDTH)
    save(path, ("".join(remarks) + body).encode())


def card_figures(report: Report, row: dict[str, Any]) -> dict[str, float | int | str]:
    """Return the figures that a card keeps of one row: flat, without unknown values.

    `file` is the start of the measured file's hash, since the card of a locally made model has
    none. `others_cores` is the load of other processes, which makes times longer.
    """
    times, frames = row["latency_ms"], report["frames"]
    agreement, truth = row["agreement"] or {}, row["truth"] or {}
    h, w = frames["hw"][0]  # images of a folder may have more sizes: the smallest one is named
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
