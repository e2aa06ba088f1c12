"""Drawing of the robot's path on the map of a report, coloured by pursued target or by time."""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from edge.lab.report import palette
from edge.lab.report.record import RunRecord
from edge.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

Rect = tuple[float, float, float, float]
"""(left, bottom, width, height), in fractions of the figure."""


class PursuitInterval(NamedTuple):
    """Time in which one target was pursued, since the start of the run."""

    label: str
    start_s: float
    end_s: float


def pursuit_intervals(record: RunRecord) -> list[PursuitInterval]:
    """Return the intervals in which targets were pursued, in order; the last has no end (inf)."""
    begins = [event for event in record.steps if event.kind in ("target", "end")]
    return [
        PursuitInterval(
            event.label, record.seconds(event.stamp_ns),
            math.inf if after is None else record.seconds(after.stamp_ns),
        )
        for event, after in zip_longest(begins, begins[1:])
        if event.kind == "target"
    ]  # fmt: skip


def is_coloured_by_target(record: RunRecord) -> bool:
    """Return True if several targets were pursued, and there is a colour for each.

    Otherwise the path is coloured by time. So is a task's path: the objects that a task names are
    not its goals.
    """
    if record.task is not None:
        return False
    pursued = {interval.label for interval in pursuit_intervals(record)}
    return len(pursued) > 1 and len(record.targets) <= len(palette.TARGETS)


def draw(figure: Figure, axes: Axes, record: RunRecord, place: Rect) -> None:
    """Draw the path with a white border that sets it off from the map, and its legend."""
    from matplotlib.collections import LineCollection

    if len(record.trajectory) < 2:
        return
    points = record.trajectory[:, :2]
    axes.plot(points[:, 0], points[:, 1], color="white", lw=5.0, zorder=3, solid_capstyle="round")
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(segments), cmap="viridis", lw=2.6, zorder=4, capstyle="round")
    if is_coloured_by_target(record):
        lines.set_color(_colours(record))
        _draw_target_legend(figure, record, place)
    else:
        lines.set_array(record.trajectory_t_s[1:])
        lines.set_clim(0.0, max(float(record.trajectory_t_s[-1]), 1e-3))
        _draw_time_bar(figure, lines, place)
    axes.add_collection(lines)


def _colours(record: RunRecord) -> list[str]:
    """Return one colour for each segment of the path, by the time of its end."""
    intervals = pursuit_intervals(record)
    starts_s = np.array([interval.start_s for interval in intervals])
    # Index of the last interval that began before each segment's end; -1 for none.
    at = np.searchsorted(starts_s, record.trajectory_t_s[1:], side="right") - 1
    colours = [palette.target_colour(i.label, record.targets) for i in intervals]
    ends_s = [interval.end_s for interval in intervals]
    return [
        colours[k] if k >= 0 and t_s <= ends_s[k] else palette.MUTED
        for k, t_s in zip(at.tolist(), record.trajectory_t_s[1:].tolist(), strict=True)
    ]


def _draw_target_legend(figure: Figure, record: RunRecord, place: Rect) -> None:
    from matplotlib.lines import Line2D

    handles = []
    for label in record.targets:
        colour = palette.target_colour(label, record.targets)
        line = Line2D([], [], color=colour, lw=2.6, marker="o", markeredgecolor="white")
        line.set_label(shorten(label, 22).replace("$", r"\$"))
        handles.append(line)
    legend = figure.legend(
        handles=handles,
        title="targets, and the paths to them",
        loc="upper left",
        bbox_to_anchor=(place[0] - 0.015, place[1] + place[3]),
        frameon=False,
        fontsize=9.5,
        title_fontsize=9.5,
        alignment="left",
    )
    for text in (legend.get_title(), *legend.get_texts()):
        text.set_color(palette.INK)


def _draw_time_bar(figure: Figure, lines: LineCollection, place: Rect) -> None:
    """Draw the colour scale of the time."""
    bar = figure.colorbar(lines, cax=figure.add_axes(place))
    bar.set_label("time of the path, s", color=palette.MUTED, fontsize=9)
    bar.ax.tick_params(labelsize=8, colors=palette.MUTED)
    bar.outline.set_visible(False)
