"""Plots of `edge eval planning`, like ViTL's figure 4: completion and explorations over p_obs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edge.host.files import write_atomically
from edge.lab.eval.intervals import Interval
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.report import Row
from edge.lab.report import canvas, palette
from edge.lab.report.canvas import style_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_IN = (7.2, 4.2)
DPI = 150
STYLES = {name: style_of(k) for k, name in enumerate(PLANNERS)}


def write_plots(rows: Sequence[Row], directory: Path) -> list[Path]:
    """Write the plots `completion` and `explorations`, each as SVG and PNG. Return the files.

    Rows for all p_obs together are left out.

    Raises:
        OSError: a file cannot be written.
    """
    rows = [row for row in rows if row.p_obs is not None]
    searching = [row for row in rows if row.planner != "clairvoyant"]
    percent = _plot(rows, lambda row: Interval(*(100 * x for x in row.complete)), _label_completion)
    attempts = _plot(searching, lambda row: row.explorations, _label_explorations)
    paths = []
    for name, images in (("completion", percent), ("explorations", attempts)):
        for kind, content in images.items():
            paths.append(directory / f"{name}.{kind}")
            write_atomically(paths[-1], content)
    return paths


def _label_completion(axes: Axes, rows: Sequence[Row]) -> None:
    worst = min((100 * row.complete.low for row in rows), default=0.0)
    bottom = 0.0 if worst < 80 else 80.0
    room = 0.04 * (100 - bottom)  # so that markers at the limits are not cut
    axes.set_ylim(bottom - (room if bottom == 0.0 else 0.0), 100 + room)
    axes.locator_params(axis="y", integer=True)
    axes.set_ylabel("tasks completed, %")
    axes.set_title("Completion rate", loc="left", color=palette.INK, fontsize=12)


def _label_explorations(axes: Axes, rows: Sequence[Row]) -> None:
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("exploration attempts per task, mean")
    axes.set_title("Exploration attempts", loc="left", color=palette.INK, fontsize=12)


def _plot(
    rows: Sequence[Row],
    figure_of: Callable[[Row], Interval],
    finish: Callable[[Axes, Sequence[Row]], None],
) -> dict[str, bytes]:
    """Return a plot's content by file ending."""
    figure, (axes,) = canvas.plots(SIZE_IN, DPI)
    lines = _curves(rows, figure_of)
    for k, (planners, figures) in enumerate(lines.items()):
        _draw_curve(axes, planners, figures, len(lines) - k)
    p_obs = sorted({row.p_obs for row in rows if row.p_obs is not None})
    axes.set_xlabel("$p_{obs}$, probability that an exploration finds its target")
    axes.set_xticks(p_obs[:: max(1, len(p_obs) // 10)])
    finish(axes, rows)
    # Outside the axes, so that it covers no data.
    legend = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "frameon": False}
    if lines:
        axes.legend(**legend, fontsize=9, labelcolor=palette.INK, handlelength=3.2)
    return {kind: canvas.content(figure, kind) for kind in ("svg", "png")}


def _curves(
    rows: Sequence[Row], figure_of: Callable[[Row], Interval]
) -> dict[tuple[str, ...], list[tuple[float, Interval]]]:
    """Return (p_obs, figure) pairs by planner. Planners without any difference share a line."""
    alike: dict[str, list[str]] = {}  # by the text of their figures: the planners that have them
    figures: dict[str, list[tuple[float, Interval]]] = {}
    for planner in dict.fromkeys(row.planner for row in rows):
        pairs = [(row.p_obs, figure_of(row)) for row in rows if row.planner == planner]
        pairs = [(p, figure) for p, figure in pairs if not math.isnan(figure.value)]
        alike.setdefault(repr(pairs), []).append(planner)
        figures[repr(pairs)] = pairs
    return {tuple(alike[key]): pairs for key, pairs in figures.items() if pairs}


def _draw_curve(
    axes: Axes, planners: tuple[str, ...], figures: list[tuple[float, Interval]], rank: int
) -> None:
    """Draw a line with the band of its 95 % intervals.

    A larger `rank` makes larger markers further down, so that overlapping lines all show.
    """
    style = STYLES[planners[0]]
    p_obs, values = [p for p, _ in figures], [f.value for _, f in figures]
    filled = style.mark in "P*X"
    axes.plot(
        p_obs, values, label="\n".join(planners), color=style.colour,
        linestyle=style.dash, linewidth=1.6, marker=style.mark, markersize=4.0 + 0.6 * rank,
        markerfacecolor=style.colour if filled else "none", markeredgewidth=1.3,
        zorder=3 - 0.1 * rank,
    )  # fmt: skip
    low, high = [f.low for _, f in figures], [f.high for _, f in figures]
    axes.fill_between(p_obs, low, high, color=style.colour, alpha=0.12, linewidth=0)
