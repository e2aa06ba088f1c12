"""Tables of a comparison: text for a terminal, HTML and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from edge.lab.eval.comparison.statistics import (
    METRICS,
    Comparison,
    ComparisonMetric,
    Estimate,
    PairedDifference,
)
from edge.lab.eval.intervals import Interval, intervals_note
from edge.lab.eval.json_lines_file import json_data
from edge.lab.eval.outcome import FAILURES
from edge.text import format_table, one_line

DASH = "–"  # for a figure without a value
# Metrics whose intervals are in the tables. All intervals are in the JSON.
BOUNDED = ("sr", "spl", "soft_spl", "wrong_stops", "zone_entries", "answers_right")
# Tables of metrics by name: title, and keys of METRICS.
SUMMARIES = {
    "summary": ("Arms", ("sr", "spl", "soft_spl", "path_m", "success_path_m", "elapsed_s")),
    "conduct": (
        "On the way",
        ("seen", "first_sight_s", "wrong_stops", "false_confirmations", "collisions",
         "zone_entries", "person_contacts", "ghost_s", "answers_right"),
    ),
    "cost": ("Cost in the tick", ("tick_p95_ms", "score_p95_ms")),
}  # fmt: skip


class ReportTable(NamedTuple):
    """A table of texts.

    Attributes:
        name: short name, unique among the tables.
        head: titles of the columns.
        rows: cells of each row; the first names the row.
        note: explanation below the table; "": none.
    """

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def tables(comparison: Comparison) -> list[ReportTable]:
    """Return every table that has rows, in reading order."""
    found = [
        summary(comparison, "summary"),
        paired(comparison),
        summary(comparison, "conduct"),
        failures(comparison),
        losses(comparison),
        *(group(comparison, by) for by in comparison.groups),
        by_word(comparison),
        summary(comparison, "cost"),
    ]
    return [table for table in found if table.rows]


def summary(comparison: Comparison, name: str) -> ReportTable:
    """Return a table of the metrics of one of SUMMARIES, one row for each arm."""
    title, wanted = SUMMARIES[name]
    figures_of_arms = comparison.figures.values()
    keys = [key for key in wanted if any(figures[key].n for figures in figures_of_arms)]
    head = ["arm", "n", *(METRICS[key].title for key in keys)]
    rows = []
    for arm, figures in comparison.figures.items():
        cells = [_figure(METRICS[key], figures[key], key in BOUNDED) for key in keys]
        rows.append([one_line(arm), str(figures["sr"].n), *cells])
    return ReportTable(name, title, head, rows if keys else [], _words(comparison, keys))


def _words(comparison: Comparison, keys: Sequence[str]) -> str:
    """Return the note below a summary: its metrics, and how to read them."""
    words = "; ".join(f"{METRICS[key].title}: {METRICS[key].words}" for key in keys)
    words = f"{words[:1].upper()}{words[1:]}."
    if len(set(comparison.outcomes.ran.sum(axis=1).tolist())) > 1:
        words += " Arms with different n ran different episodes: compare them by pairs."
    return f"{words} {intervals_note(comparison.outcomes.world)}" if "spl" in keys else words


def paired(comparison: Comparison) -> ReportTable:
    """Return a table of each arm against the baseline, on the same episodes."""
    head = ("arm", "n", "SR, % points", "SPL", "SPL ratio", "soft SPL", "better",
            "worse", "both", "path ratio", "time ratio")  # fmt: skip
    rows = [_pair_row(pair) for pair in comparison.pairs]
    left_out = [f"{p.arm} {p.missing}" for p in comparison.pairs if p.missing]
    base = _arm_name(comparison, comparison.baseline)
    note = (
        "Differences of means (arm minus baseline), and ratios of means, on the n episodes that "
        "both ran. Better, worse: episodes with higher and lower SPL. Both: episodes in which both "
        "succeeded, used for path and time."
    )
    if left_out:
        note += f" Left out, as only one of the two ran them: {one_line(', '.join(left_out))}."
    return ReportTable("paired", f"Against {base}, paired", head, rows, note)


def _pair_row(pair: PairedDifference) -> list[str]:
    return [
        one_line(pair.arm), str(pair.n),
        bounded(pair.sr, 1, 100.0, "+"), bounded(pair.spl, 3, 1.0, "+"),
        bounded(pair.spl_ratio, 3), bounded(pair.soft_spl, 3, 1.0, "+"),
        str(pair.won), str(pair.lost), str(pair.both),
        bounded(pair.path_ratio, 3), bounded(pair.time_ratio, 3),
    ]  # fmt: skip


def failures(comparison: Comparison) -> ReportTable:
    """Return a table of failed episodes by kind of failure, one row for each arm."""
    kinds = [k for k in FAILURES if any(f[k] for f in comparison.failures.values())]
    rows = []
    for a, (name, counts) in enumerate(comparison.failures.items()):
        ran = int(comparison.outcomes.ran[a].sum())
        failed = sum(counts.values())
        rows.append([one_line(name), str(ran), str(failed), *(str(counts[k]) for k in kinds)])
    return ReportTable("failures", "Failures", ("arm", "n", "failed", *kinds), rows)


def losses(comparison: Comparison) -> ReportTable:
    """Return a table that decomposes the lost SPL, one row for each arm."""
    head = ("arm", "n", "SPL", "failures", "search", "approach", "search excess, m",
            "approach excess, m")  # fmt: skip
    rows = [
        [one_line(name), str(loss.n), f"{loss.spl:.3f}", f"{loss.failures:.3f}",
         f"{loss.search:.3f}", f"{loss.approach:.3f}", bounded(loss.search_m, 2),
         bounded(loss.approach_m, 2)]
        for name, loss in comparison.losses.items()
    ]  # fmt: skip
    note = (
        "SPL + failures + search + approach = 1. Search: path until the target was first in view, "
        "plus the distance then left, beyond the shortest path. Approach: path from there beyond "
        "the distance then left. Excess: metres per success."
    )
    return ReportTable("losses", "Where the rest of the SPL goes", head, rows, note)


def group(comparison: Comparison, by: str) -> ReportTable:
    """Return a table of SPL and SR of each arm, one row for each group."""
    arms = comparison.outcomes.arms
    rows = []
    for label, figures in comparison.groups[by].items():
        n = max(figures[name]["sr"].n for name in arms)
        cells = [_spl_sr(figures[name]) for name in arms]
        rows.append([one_line(label), str(n), *cells])
    note = "SPL with its interval, and SR in %."
    return ReportTable(f"by {by}", f"By {by}", (by, "n", *map(one_line, arms)), rows, note)


def by_word(comparison: Comparison) -> ReportTable:
    """Return a table of what became of the episodes of each target, with the detector's recall."""
    outcomes, rows = comparison.outcomes, []
    for word in sorted(set(outcomes.target.tolist()) - {""}):
        for a, arm in enumerate(outcomes.arms):
            inside = outcomes.ran[a] & (outcomes.target == word)
            if not inside.any():
                continue
            views, found = (np.nansum(outcomes[key][a, inside]) for key in ("views", "detected"))
            ends = outcomes.failure[a, inside]
            rows.append([
                one_line(word), one_line(arm), str(int(inside.sum())),
                f"{found / views:.2f}" if views else DASH, str(int((ends == "").sum())),
                *(str(int((ends == kind).sum())) for kind in FAILURES),
            ])  # fmt: skip
    # Kinds of failures that never occur have no column.
    used = [k for k in range(len(FAILURES)) if any(row[5 + k] != "0" for row in rows)]
    head = ("target", "arm", "n", "recall", "reached", *(FAILURES[k] for k in used))
    note = (
        "Recall: share of the views of a target (one object in one image, within range) in which "
        "the detector found it, with an IoU of 0.5 and the score of an instance. Then the "
        "number of episodes by their end."
    )
    rows = [row[:5] + [row[5 + k] for k in used] for row in rows]
    return ReportTable("words", "By word", head, rows, note)


def _spl_sr(figures: dict[str, Estimate]) -> str:
    """Format `0.71 [0.66, 0.75], 80`: SPL with its interval, and SR in %."""
    if not figures["sr"].n:
        return DASH
    share = 100 * figures["sr"].interval.value
    return f"{bounded(figures['spl'].interval, 2)}, {share:.0f}"


def _arm_name(comparison: Comparison, index: int) -> str:
    arms = comparison.outcomes.arms
    return one_line(arms[index]) if arms else DASH


def _figure(metric: ComparisonMetric, figure: Estimate, bounds: bool) -> str:
    """Format a figure, with its interval if `bounds`."""
    if bounds:
        return bounded(figure.interval, metric.digits, metric.scale)
    value = figure.interval.value
    return DASH if math.isnan(value) else f"{metric.scale * value:.{metric.digits}f}"


def bounded(interval: Interval, digits: int, scale: float = 1.0, sign: str = "") -> str:
    """Format `0.71 [0.66, 0.75]`, after scaling; without bounds if there are none.

    If `sign` is "+", positive numbers get their sign, too.
    """
    if math.isnan(interval.value):
        return DASH
    value, low, high = (f"{scale * x:{sign}.{digits}f}" for x in interval)
    return value if math.isnan(interval.low) else f"{value} [{low}, {high}]"


# -- formats ------------------------------------------------------------------------------------


def text(table: ReportTable) -> str:
    """Return title and aligned columns for a terminal."""
    return f"{table.title}\n{format_table([table.head, *table.rows], left=1)}"


def html(table: ReportTable) -> str:
    """Return a section of a page."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<section><h2>{escape(table.title)}</h2><div class="scroll"><table><tr>{head}</tr>'
        f"{rows}</table></div>{note}</section>"
    )


def to_json(comparison: Comparison) -> bytes:
    """Return everything as JSON; NaN, which JSON lacks, becomes null."""
    outcomes = comparison.outcomes
    data = {
        "baseline": outcomes.arms[comparison.baseline] if outcomes.arms else None,
        "resampled": comparison.unit,
        "episodes": len(outcomes.episodes),
        "worlds": len(set(outcomes.world.tolist())),
        "passed_over": outcomes.n_ignored,
        "arms": comparison.figures,
        "paired": {pair.arm: pair for pair in comparison.pairs},
        "failures": comparison.failures,
        "losses": comparison.losses,
        "groups": comparison.groups,
    }
    return json.dumps(json_data(data), indent=1, allow_nan=False, ensure_ascii=False).encode()
