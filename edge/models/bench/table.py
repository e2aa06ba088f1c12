"""The comparison as a table for a terminal of 110 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from edge.host import machine

_GROUPS = (
    ("", 2),
    ("latency, ms: p50 (p95)", 4),
    ("", 1),
    ("against FP32", 3),
    ("against truth", 2),
)
_HEADINGS = (
    "variant", "on", "pre", "session", "post", "all", "MB", "recall", "prec.", "score", "recall",
    "prec.",
)  # fmt: skip
_LEFT = 2
_WIDTH = 110
_GAP = "  "
_QUIET_CORES = 0.2
"""Below this, other processes do not lengthen times by much."""


def as_text(report: dict[str, Any]) -> str:
    """Header, table and footnotes of one family's report."""
    return "\n".join([*_header(report), "", *_rows(report), *_footnotes(report)])


def _header(report: dict[str, Any]) -> list[str]:
    frames, asked = report["frames"], report["prompts"]
    sizes = ", ".join(f"{w}x{h}" for h, w in frames["hw"])
    things = f", {frames['things']} things in them" if frames["things"] is not None else ""
    unknown = report["unknown_labels"]
    lacking = f" (no word for {', '.join(unknown)})" if unknown else ""
    lines = [
        f"{report['family']}: {frames['count']} frames of {sizes} px ({frames['source']}){things}",
        f"{len(asked)} prompts{lacking}",
        f"boxes above {report['tau_det']:g}; {_threads(report['threads'])} on the CPU",
        machine.summary(report["machine"]),
    ]
    return [textwrap.fill(line, _WIDTH, subsequent_indent=_GAP) for line in lines]


def _threads(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _rows(report: dict[str, Any]) -> list[str]:
    prefix = f"{report['family']}-"
    rows = [_cells(row, row["name"].removeprefix(prefix)) for row in report["rows"]]
    full = [_HEADINGS, *(cells for cells in rows if len(cells) == len(_HEADINGS))]
    widths = [max(len(cells[k]) for cells in full) for k in range(len(_HEADINGS))]
    for k in range(_LEFT):
        widths[k] = max(len(cells[k]) for cells in [_HEADINGS, *rows])
    return [_group_line(widths), *(_line(cells, widths) for cells in [_HEADINGS, *rows])]


def _cells(row: dict[str, Any], name: str) -> tuple[str, ...]:
    """One cell per heading; for a variant without figures name, provider and why."""
    if row["state"] != "ran":
        return (name, row["on"], row["why"])
    times = [f"{t['p50']:.1f} ({t['p95']:.1f})" for t in row["latency_ms"].values()]
    fp32, truth = row["agreement"] or {}, row["truth"] or {}
    shares = [fp32.get("recall"), fp32.get("precision"), fp32.get("score_error")]
    shares += [truth.get("recall"), truth.get("precision")]
    memory = f"{row['memory_mb']:.0f}"
    if (gpu := row["gpu_memory_mb"]) is not None:
        memory += f"+{gpu:.0f}"
    return (name, row["on"], *times, memory, *("-" if s is None else f"{s:.2f}" for s in shares))


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    if len(cells) < len(widths):
        widths = [*widths[:_LEFT], 0]
    left = [cell.ljust(w) for cell, w in zip(cells[:_LEFT], widths, strict=False)]
    right = [cell.rjust(w) for cell, w in zip(cells[_LEFT:], widths[_LEFT:], strict=True)]
    return _GAP.join([*left, *right]).rstrip()


def _group_line(widths: Sequence[int]) -> str:
    parts, start = [], 0
    for title, count in _GROUPS:
        width = sum(widths[start : start + count]) + len(_GAP) * (count - 1)
        parts.append(title.center(width))
        start += count
    return _GAP.join(parts).rstrip()


def _footnotes(report: dict[str, Any]) -> list[str]:
    ran = [row for row in report["rows"] if row["state"] == "ran"]
    lines = []
    if again := report["again"]:
        lines.append(
            f"{again['name']} on {again['on']} once more at the end: session "
            f"{again['session_ms']:.1f} ms, {again['ratio']:.2f} of what it was at first"
        )
    others = max((row["others_cores"] or 0.0 for row in ran), default=0.0)
    if others > _QUIET_CORES:
        lines.append(
            f"other processes kept up to {others:.1f} of {report['machine']['cores']} cores busy: "
            "on a quiet machine the times are shorter"
        )
    if any(row["gpu_memory_mb"] is not None for row in ran):
        lines.append("MB: what the process grew by + what the GPU's memory in use did")
    for row in ran:
        if row["invalid_boxes"]:
            lines.append(f"{row['name']} on {row['on']}: {row['invalid_boxes']} boxes not finite")
    return lines
