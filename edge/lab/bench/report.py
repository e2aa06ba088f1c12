"""Output of `edge bench --models`: a table on the terminal, and a JSON file."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

from edge.host import machine, resources
from edge.host.files import save
from edge.perception.runtime.health import WHY_INVALID
from edge.text import format_table

Report = dict[str, Any]
"""Figures of a family's variants, as `compare.compare` returns them."""

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
