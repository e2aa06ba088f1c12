"""Plots of `edge eval planning`, like ViTL's figure 4: completion and explorations over p_obs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from edge.lab.eval.intervals import Interval
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.report import Row
from edge.lab.report import canvas, palette

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_IN = (7.2, 4.2)
DPI = 150


def figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """Return the plots `completion` and `explorations`, without rows for all p_obs together."""
    rows = [row for row in rows if row.p_obs is not None]
    searching = [row for row in rows if row.planner != "clairvoyant"]
    return {
        "completion": _completion(rows),
        "explorations": _plot(
            searching, lambda row: row.explorations, "exploration attempts per task, mean"
        ),
    }


def _completion(rows: Sequence[Row]) -> Figure:
    """Plot from 0 % on, or from 80 % on if all are above."""
    figure = _plot(
        rows, lambda row: Interval(*(100 * x for x in row.complete)), "tasks completed, %"
    )
    worst = min((100 * row.complete.low for row in rows), default=0.0)
    figure.axes[0].set_ylim(0.0 if worst < 80 else 80.0, 101.0)
    return figure


def _plot(rows: Sequence[Row], figure_of: Callable[[Row], Interval], label: str) -> Figure:
    """Plot a figure over p_obs, with a line for each planner."""
    figure, (axes,) = canvas.plots(SIZE_IN, DPI)
    planners = list(dict.fromkeys(row.planner for row in rows))
    for planner in planners:
        found = [(row.p_obs, figure_of(row)) for row in rows if row.planner == planner]
        found = [(p_obs, value) for p_obs, value in found if not math.isnan(value.value)]
        x, values = [p_obs for p_obs, _ in found], [value for _, value in found]
        canvas.draw_curve(axes, x, values, list(PLANNERS).index(planner), planner)
    axes.set_xlabel("$p_{obs}$, probability that an exploration finds its target")
    axes.set_ylim(bottom=0.0)
    axes.set_title(label, loc="left", color=palette.INK, fontsize=12)
    if planners:
        canvas.draw_legend(axes)
    return figure
