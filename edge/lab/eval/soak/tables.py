"""Tables that `edge soak` prints at its end: broken rules, growth, faults and missions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from edge.lab.eval.comparison.tables import ReportTable, text
from edge.lab.eval.soak.record import Row, rows_of_kind
from edge.text import one_line

_TWO_AT_ONCE = "two at once"


def summary(rows: Sequence[Row]) -> str:
    """Return the tables of a record that have rows."""
    tables = (_broken(rows), _growth(rows), _faults(rows), _missions(rows))
    return "\n\n".join(text(table) for table in tables if table.rows)


def _broken(rows: Sequence[Row]) -> ReportTable:
    found = [
        [f"{row['t_s']:.0f}", row["rule"], one_line(row["why"])]
        for row in rows_of_kind(rows, "broken")
    ]
    return ReportTable("broken", "What did not hold", ["s", "rule", "why"], found)


def _growth(rows: Sequence[Row]) -> ReportTable:
    found = [
        [
            row["name"], f"{row['per_h']:+.2f}", f"{row['low']:+.2f} … {row['high']:+.2f}",
            f"{row['most_per_h']:g}", f"{0.5 * (row['high'] - row['low']):.2f}", f"{row['unit']}/h",
        ]
        for row in rows_of_kind(rows, "growth")
    ]  # fmt: skip
    head = ["what", "grows by", "95 % interval", "at most", "resolves", "unit"]
    return ReportTable("growth", "Growth, over samples without a fault", head, found)


def _faults(rows: Sequence[Row]) -> ReportTable:
    named: dict[str, list[Row]] = {}
    for row in rows_of_kind(rows, "fault"):
        named.setdefault(_TWO_AT_ONCE if " + " in row["name"] else row["name"], []).append(row)
    head = ["fault", "times", "recovered in s, p50", "longest", "broke"]
    return ReportTable("faults", "Faults", head, list(_by_fault(named)))


def _by_fault(named: dict[str, list[Row]]) -> Iterator[list[str]]:
    for name, found in sorted(named.items()):
        times_s = [row["recovered_s"] for row in found]
        broke = one_line(
            "; ".join(dict.fromkeys(_failure_text(row) for row in found if row["broken"]))
        )
        yield [name, f"{len(found)}", f"{np.median(times_s):.1f}", f"{max(times_s):.1f}", broke]


def _failure_text(row: Row) -> str:
    return f"{row['name']}: {row['broken']}" if " + " in row["name"] else str(row["broken"])


def _missions(rows: Sequence[Row]) -> ReportTable:
    found = [
        [
            f"{row['t_s']:.0f}", one_line(row["instruction"], 100), row["phase"],
            f"{row['elapsed_s']:.0f}", f"{row['path_m']:.1f}", one_line(row["reason"], 200),
        ]
        for row in rows_of_kind(rows, "mission")
    ]  # fmt: skip
    return ReportTable(
        "missions", "Missions", ["ended, s", "mission", "phase", "took, s", "m", "reason"], found
    )
