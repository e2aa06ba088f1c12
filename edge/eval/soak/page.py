"""One self-contained page of a soak: its verdict, what was watched, faults, missions, growth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from edge.eval.comparison.tables import Table
from edge.eval.comparison.tables import html as section
from edge.eval.soak import plots
from edge.eval.soak.record import Row, of, verdict
from edge.host.files import save
from edge.report import palette
from edge.report.document import data_url, document
from edge.text import one_line

NAME = "soak.html"
_AT_ONCE = "two at once"
_STYLE = """
table { font-size: 14px; } td { vertical-align: top; overflow-wrap: anywhere; }
th, td { text-align: left; } td:last-child { white-space: normal; }
.plots { display: grid; gap: 14px; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); }
.plots img { display: block; width: 100%; height: auto; border-radius: 8px; background: #fff; }
"""


def write(rows: Sequence[Row], folder: Path, machine: str) -> Path:
    """Write `NAME` into the folder.

    Raises:
        FileError: it cannot be written.
    """
    path = folder / NAME
    save(path, html(rows, machine).encode("utf-8", errors="replace"))
    return path


def html(rows: Sequence[Row], machine: str) -> str:
    """The page as text, of the rows of a record."""
    phase = "failed" if of(rows, "broken") else "reached"
    word = "broken" if phase == "failed" else "held"
    tables = filter(lambda table: table.rows, (_broken(rows), _growth(rows), _faults(rows)))
    missions = _missions(rows)
    body = (
        f'<header><span class="badge" style="background:{palette.OUTCOME[phase]}">{word}</span>'
        f'<h1>Soak</h1><p class="reason">{escape(verdict(rows))}</p></header>',
        _tiles(rows),
        _plots(rows),
        *map(section, tables),
        section(missions) if missions.rows else "",
    )
    return document(f"Soak: {word}", "".join(body), machine, _STYLE)


def _tiles(rows: Sequence[Row]) -> str:
    samples, missions = of(rows, "sample"), of(rows, "mission")
    last = samples[-1] if samples else {}
    reached = sum(row["phase"] == "reached" for row in missions)
    calm = [s for s in samples if s["calm"] and s.get("ticks")]
    tiles = {
        "time": f"{rows[-1]['t_s'] / 60.0:.1f} min",
        "faults": f"{len(of(rows, 'fault'))}",
        "missions reached": f"{reached} of {len(missions)}",
        "goals": f"{last.get('goals', 0)}",
        "tick p99, median of calm seconds": _median(calm, "tick_ms"),
        "between ticks p99, likewise": _median(calm, "interval_ms"),
        "memory of the service": f"{last['service']['memory_mb']:.0f} MB"
        if last.get("service")
        else "–",
    }
    cells = (
        f'<div class="tile"><b>{escape(v)}</b><span>{escape(k)}</span></div>'
        for k, v in tiles.items()
    )
    return f'<div class="tiles">{"".join(cells)}</div>'


def _median(samples: Sequence[Row], key: str) -> str:
    values = [sample[key][1] for sample in samples if sample.get(key)]
    return f"{np.median(values):.1f} ms" if values else "–"


def _plots(rows: Sequence[Row]) -> str:
    figures = "".join(
        f'<figure><img alt="{escape(title)}" src="{data_url("png", content)}"></figure>'
        for title, content in plots.images(rows).items()
    )
    note = '<p class="note">Grey: a fault, until it ends; red: one after which a rule broke.</p>'
    return f'<section><h2>Over time</h2><div class="plots">{figures}</div>{note}</section>'


def _broken(rows: Sequence[Row]) -> Table:
    found = [[f"{row['t_s']:.0f}", row["rule"], row["why"]] for row in of(rows, "broken")]
    return Table("broken", "What did not hold", ["s", "rule", "why"], found)


def _growth(rows: Sequence[Row]) -> Table:
    found = [
        [
            row["name"], f"{row['per_h']:+.2f}", f"{row['low']:+.2f} … {row['high']:+.2f}",
            f"{row['most_per_h']:g}", f"{0.5 * (row['high'] - row['low']):.2f}", f"{row['unit']}/h",
        ]
        for row in of(rows, "growth")
    ]  # fmt: skip
    head = ["what", "grows by", "95 % interval", "at most", "resolves", "unit"]
    return Table(
        "growth", "Growth", head, found, "Theil and Sen's slope over samples without a fault."
    )


def _faults(rows: Sequence[Row]) -> Table:
    named: dict[str, list[Row]] = {}
    for row in of(rows, "fault"):
        named.setdefault(_AT_ONCE if " + " in row["name"] else row["name"], []).append(row)
    return Table("faults", "Faults", ["fault", "times", "recovered in s, p50", "longest", "broke"],
                 list(_by_fault(named)), "From its end until all held that must.")  # fmt: skip


def _by_fault(named: dict[str, list[Row]]) -> Iterator[list[str]]:
    for name, found in sorted(named.items()):
        times_s = [row["recovered_s"] for row in found]
        broke = "; ".join(dict.fromkeys(_broke(row) for row in found if row["broken"]))
        yield [name, f"{len(found)}", f"{np.median(times_s):.1f}", f"{max(times_s):.1f}", broke]


def _broke(row: Row) -> str:
    return f"{row['name']}: {row['broken']}" if " + " in row["name"] else str(row["broken"])


def _missions(rows: Sequence[Row]) -> Table:
    found = [
        [
            f"{row['t_s']:.0f}", one_line(row["instruction"], 100), row["phase"],
            f"{row['elapsed_s']:.0f}", f"{row['path_m']:.1f}", one_line(row["reason"], 200),
        ]
        for row in of(rows, "mission")
    ]  # fmt: skip
    return Table(
        "missions", "Missions", ["ended, s", "mission", "phase", "took, s", "m", "reason"], found
    )
