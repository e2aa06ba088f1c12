"""Gantt chart of a mission: the time in which each target was pursued, and its outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from edge.lab.report import canvas, palette
from edge.lab.report.record import RunRecord
from edge.text import shorten
from edge.types import MissionEvent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Lengths and font sizes in px.
WIDTH = 1100.0  # of the page
LEFT, RIGHT, TOP, FOOT = 170.0, 24.0, 14.0, 62.0  # margins
ROW = 28.0  # height of a row
BAR = 0.5  # height of a bar, in rows
TEXT = 11.0  # font size
MAX_ROWS = 40  # further targets are not shown
LINE, ZEBRA = "#dde2ea", "#f6f8fb"  # colours of the grid, and of every second row
# Possible distances between two labels of the time axis.
TICKS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 18000, 36000)


class EventMark(NamedTuple):
    """Look of an event of a target.

    Attributes:
        marker: matplotlib's name of the shape.
        fill: colour.
        rim: colour.
        size: in px.
        meaning: text of the legend.
    """

    marker: str
    fill: str
    rim: str
    size: float
    meaning: str


MARKS = {
    "seen": EventMark("o", "#ffffff", palette.INK, 9.0, "seen"),
    "warning": EventMark("^", palette.WARNING, palette.WARNING, 11.0, "warning"),
    "failed": EventMark("X", palette.OUTCOME["failed"], "#ffffff", 15.0, "failed"),
    "reached": EventMark(
        "o", palette.OUTCOME["reached"], "#ffffff", 18.0, "reached, in this order"
    ),
}
"""Marks by the kind of a `MissionEvent`."""


class PursuitInterval(NamedTuple):
    """Time in which one target was pursued.

    Attributes:
        label: name of the target.
        start_s: start of the interval, since the start of the run.
        settled: True if the target was reached or failed in that time, and for the last interval.
        reason: text of the event that started it.
    """

    label: str
    start_s: float
    end_s: float
    settled: bool
    reason: str


def pursuit_intervals(record: RunRecord) -> list[PursuitInterval]:
    """Return the intervals in which targets were pursued, in order of time."""
    done: list[PursuitInterval] = []
    pursued: MissionEvent | None = None
    settled = False
    for event in record.steps:
        if event.kind in ("target", "end"):
            done += _interval(record, pursued, record.seconds(event.stamp_ns), settled)
            pursued, settled = (event if event.kind == "target" else None), False
        elif pursued is not None and event.label == pursued.label:
            settled |= event.kind in ("reached", "failed")
    return done + _interval(record, pursued, _last_s(record), True)


def _interval(
    record: RunRecord, event: MissionEvent | None, end_s: float, settled: bool
) -> list[PursuitInterval]:
    """Return the interval that an event started, as a list; [] without an event."""
    if event is None:
        return []
    start_s = record.seconds(event.stamp_ns)
    return [PursuitInterval(event.label, start_s, max(start_s, end_s), settled, event.text)]


def _last_s(record: RunRecord) -> float:
    """Return the time of the newest event in the record."""
    times = [t_s for t_s, _ in record.events[-1:]]
    times += record.trajectory_t_s[-1:].tolist()
    times += [record.seconds(event.stamp_ns) for event in record.steps[-1:]]
    return max(times, default=0.0)


def draw(record: RunRecord) -> Axes | None:
    """Draw bars for pursued targets and marks for events; None if there is nothing to show."""
    events = record.steps
    labels = list(dict.fromkeys(s.label for s in events if s.label))
    if not labels:
        return None
    rows = {label: k for k, label in enumerate(labels[:MAX_ROWS])}
    begin_s = min(0.0, record.seconds(events[0].stamp_ns))
    end_s = max(_last_s(record), begin_s + 1.0)
    height = TOP + ROW * len(rows) + FOOT
    page = canvas.page(WIDTH, height)
    box = (LEFT / WIDTH, FOOT / height, (WIDTH - LEFT - RIGHT) / WIDTH, ROW * len(rows) / height)
    chart = page.figure.add_axes(box, xlim=(begin_s, end_s), ylim=(len(rows) - 0.5, -0.5))
    _draw_axes(chart, rows, record.targets)
    shown = [interval for interval in pursuit_intervals(record) if interval.label in rows]
    _draw_bars(chart, shown, rows, record.targets)
    _draw_events(chart, record, rows)
    handles = _legend(chart)
    place = ((LEFT - 14) / WIDTH, 0.0)
    page.figure.legend(handles=handles, loc="lower left", bbox_to_anchor=place, ncols=len(handles),
                       frameon=False, fontsize=TEXT, labelcolor=palette.MUTED)  # fmt: skip
    if len(labels) > len(rows):
        more = f"{len(labels) - len(rows)} more targets are not shown"
        canvas.write(page, more, WIDTH - RIGHT, height - 16, TEXT, ha="right", color=palette.MUTED)
    return page


def in_words(record: RunRecord) -> str:
    """Return the chart as text, for readers who cannot see it."""
    parts = (
        f"{s.start_s:.1f} to {s.end_s:.1f} s: {shorten(s.reason, 300)}"
        for s in pursuit_intervals(record)
    )
    return "; ".join(["The mission over time", *parts])


def _draw_axes(chart: Axes, rows: dict[str, int], targets: Mapping[str, str]) -> None:
    """Draw a row for each target, and round numbers along the time axis."""
    for k in range(0, len(rows), 2):
        chart.axhspan(k - 0.5, k + 0.5, color=ZEBRA, zorder=0)
    names = [shorten(label, 22) for label in rows]
    chart.set_yticks(list(rows.values()), names, fontsize=TEXT, fontweight="bold")
    for tick, label in zip(chart.get_yticklabels(), rows, strict=True):
        tick.set(color=palette.target_colour(label, targets), parse_math=False)
    begin_s, end_s = chart.get_xlim()
    step_s = next((t for t in TICKS_S if (end_s - begin_s) / t <= 12), TICKS_S[-1] * 10)
    ticks_s = [k * step_s for k in range(int(end_s / step_s) + 1)]
    words = [f"{t:g} s" if t < 300 else f"{t / 60:g} min" for t in ticks_s]
    chart.set_xticks(ticks_s, words, fontsize=TEXT, color=palette.MUTED)
    chart.grid(axis="x", color=LINE)
    chart.set_axisbelow(True)
    chart.tick_params(length=0, pad=8)
    chart.spines[:].set_visible(False)


def _draw_bars(
    chart: Axes,
    pursued: Sequence[PursuitInterval],
    rows: dict[str, int],
    targets: Mapping[str, str],
) -> None:
    """Draw the bars; a switch before the target was reached is an arrow to the next bar."""
    least_s = (chart.get_xlim()[1] - chart.get_xlim()[0]) / 400  # so that every bar is visible
    chart.barh(
        [rows[interval.label] for interval in pursued],
        [max(least_s, interval.end_s - interval.start_s) for interval in pursued],
        left=[interval.start_s for interval in pursued],
        height=BAR,
        color=[palette.target_colour(interval.label, targets) for interval in pursued],
    )
    arrow = {"arrowstyle": "-|>", "color": palette.INK, "shrinkA": 0, "shrinkB": 0}
    for before, after in pairwise(pursued):
        if not before.settled:
            y0, y1 = rows[before.label], rows[after.label]
            tip = y1 - BAR / 2 if y1 > y0 else y1 + BAR / 2
            chart.annotate("", (after.start_s, tip), (after.start_s, y0), arrowprops=arrow)


def _draw_events(chart: Axes, record: RunRecord, rows: dict[str, int]) -> None:
    """Draw the mission's end, and the targets' events; reached targets are numbered."""
    events = record.steps
    for event in events:
        if event.kind == "end":
            colour = palette.outcome_colour(record.mission.phase)
            chart.axvline(record.seconds(event.stamp_ns), color=colour, lw=2.0, clip_on=False)
    # Marks of later kinds are on top of those of earlier ones, and of the bars.
    for order, (kind, look) in enumerate(MARKS.items(), start=5):
        same_kind = [s for s in events if s.kind == kind]
        for number, event in enumerate(same_kind, start=1):
            if event.label in rows:
                at = (max(record.seconds(event.stamp_ns), chart.get_xlim()[0]), rows[event.label])
                chart.plot(*at, **_marker_style(look), zorder=order, clip_on=False)
                if kind == "reached":
                    canvas.write(chart, f"{number}", *at, 10.0, ha="center", color="#ffffff",
                                 zorder=order)  # fmt: skip


def _marker_style(mark: EventMark) -> dict:
    """Return a mark as arguments of matplotlib's `plot`."""
    return {
        "marker": mark.marker, "ms": mark.size, "mfc": mark.fill, "mec": mark.rim, "mew": 1.4,
        "ls": "none",
    }  # fmt: skip


def _legend(chart: Axes) -> list:
    """Return the entries of the legend: all marks, and the arrow of a switch."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], **_marker_style(m), label=m.meaning) for m in MARKS.values()]
    switch = {"marker": r"$\downarrow$", "color": palette.INK, "ls": "none", "ms": 8}
    return [*handles, Line2D([], [], **switch, label="switched to another target")]
