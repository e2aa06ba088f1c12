"""Plots of a comparison: SPL and SR, paired differences, SPL over distance, success over budget.

SR is the success rate of an arm, and SPL its success weighted by path length (both from 0 to 1).
Masks of episodes are (E,) bool.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from edge.lab.eval.comparison.outcomes import Outcomes
from edge.lab.eval.comparison.statistics import Comparison, arm_means, spl_of
from edge.lab.eval.intervals import Interval, clusters
from edge.lab.report import canvas, palette
from edge.lab.report.canvas import style_of
from edge.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 7.6
MAX_NAME = 32  # characters of an arm's name
BINS = 5  # most groups of episodes by distance
MIN_A_BIN = 8  # least number of episodes in a group
BUDGETS = 8.0  # largest path budget of the plot, in lengths of the shortest path


def rates(comparison: Comparison) -> Figure:
    """Plot SPL and success rate of each arm."""
    names = comparison.outcomes.arms
    figure, (left, right) = canvas.plots((WIDTH_IN, 0.9 + 0.34 * len(names)), 2)
    for axes, key, title, scale in ((left, "spl", "SPL", 1.0), (right, "sr", "SR, %", 100.0)):
        found = [comparison.figures[name][key].interval for name in names]
        _draw_forest(axes, found, list(range(len(names))), scale, 3 if key == "spl" else 1)
        axes.set_title(title, loc="left", color=palette.INK, fontsize=11)
    _set_names(left, names)
    right.set_yticks(range(len(names)), [""] * len(names))
    right.set_ylim(left.get_ylim())
    return figure


def differences(comparison: Comparison) -> Figure:
    """Plot the paired differences of SPL against the baseline."""
    outcomes, pairs = comparison.outcomes, comparison.pairs
    figure, (axes,) = canvas.plots((WIDTH_IN, 1.1 + 0.34 * len(pairs)))
    rows = [outcomes.arms.index(pair.arm) for pair in pairs]
    axes.axvline(0.0, color=palette.INFLATED, linewidth=1.2, zorder=1)
    _draw_forest(axes, [pair.spl for pair in pairs], rows, 1.0, 3, "+")
    _set_names(axes, [f"{shorten(p.arm, MAX_NAME)} (n {p.n})" for p in pairs])
    base = shorten(outcomes.arms[comparison.baseline], MAX_NAME)
    _set_title(axes, f"SPL minus that of {base}, same episodes")
    return figure


def distances(comparison: Comparison) -> Figure:
    """Plot SPL over the length of the shortest path."""
    outcomes = comparison.outcomes
    figure, (axes,) = canvas.plots((WIDTH_IN, 3.8))
    bins = _bins(outcomes.shortest_m)
    cluster, _ = clusters(outcomes.world)
    spl = spl_of(outcomes)
    middles = [float(np.median(outcomes.shortest_m[inside])) for inside in bins]
    # By bin, by arm.
    found = [arm_means([spl[:, inside]], cluster[inside])[0] for inside in bins]
    for a in range(len(outcomes.arms)):
        # Shift each arm, so that whiskers do not overlap.
        shift = 1.0 + 0.012 * (a - (len(outcomes.arms) - 1) / 2)
        x, name = [shift * m for m in middles], shorten(outcomes.arms[a], MAX_NAME)
        canvas.draw_curve(axes, x, [row[a] for row in found], a, name)
    axes.set_ylim(0.0, 1.0)
    axes.set_xlabel("shortest path, m (median of each fifth of the episodes)"
                    if len(bins) == BINS else "shortest path, m (medians)")  # fmt: skip
    _set_title(axes, "SPL by the length of the shortest path")
    canvas.draw_legend(axes)
    return figure


def budget(comparison: Comparison) -> Figure:
    """Plot the share of episodes that succeed within a path budget."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    outcomes = comparison.outcomes
    figure, (axes,) = canvas.plots((WIDTH_IN, 3.8))
    at = np.geomspace(1.0, BUDGETS, 200)
    for a, name in enumerate(outcomes.arms):
        look = style_of(a)
        share = 100 * within_budget(outcomes, a, at)
        axes.plot(at, share, color=look.colour, linestyle=look.dash, linewidth=1.8,
                  label=shorten(name, MAX_NAME), drawstyle="steps-post")  # fmt: skip
    axes.set_xscale("log", base=2)
    axes.set_xlim(1.0, BUDGETS)
    axes.set_xticks([1, 1.5, 2, 3, 4, 6, 8])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0.0, 101.0)
    axes.set_xlabel("path budget, in lengths of the shortest path")
    _set_title(axes, "Episodes that succeed within a path budget, %")
    canvas.draw_legend(axes)
    return figure


def within_budget(outcomes: Outcomes, arm: int, budgets: np.ndarray) -> np.ndarray:
    """Return (n,) share of an arm's episodes that succeed within each path budget.

    A budget is a factor on the length of the shortest path.
    """
    ran = outcomes.ran[arm]
    shortest = np.maximum(outcomes["shortest_m"][arm][ran], 1e-9)
    needed = np.where(
        outcomes.success[arm][ran], np.maximum(outcomes["path_m"][arm][ran] / shortest, 1.0),
        math.inf,
    )  # fmt: skip
    return np.searchsorted(np.sort(needed), budgets, side="right") / max(len(needed), 1)


def _bins(shortest_m: np.ndarray) -> list[np.ndarray]:
    """Return (E,) bool masks: fifths of the episodes by distance; fewer for few episodes."""
    n = max(1, min(BINS, len(shortest_m) // MIN_A_BIN))
    order = np.argsort(shortest_m, kind="stable")
    bins = []
    for part in np.array_split(order, n):
        inside = np.zeros(len(shortest_m), bool)
        inside[part] = True
        bins.append(inside)
    return bins


PLOTS: dict[str, tuple[Callable[[Comparison], Figure], str]] = {
    "rates": (rates, "SPL and success rate of each arm, with 95 % intervals"),
    "differences": (differences, "SPL of each arm minus the baseline's, on the same episodes"),
    "distances": (distances, "SPL over the length of the shortest path"),
    "budget": (budget, "Share of episodes that succeed within a path budget"),
}
"""By name: the function that plots a comparison, and a description."""


def figures(comparison: Comparison) -> dict[str, Figure]:
    """Return each plot by name.

    Without any record there is no plot, and without a second arm no plot of differences.
    """
    if not comparison.outcomes.ran.any():
        return {}
    drawn = [name for name in PLOTS if name != "differences" or comparison.pairs]
    return {name: PLOTS[name][0](comparison) for name in drawn}


# -- drawing ------------------------------------------------------------------------------------


def _set_title(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", color=palette.INK, fontsize=11, parse_math=False)


def _draw_forest(
    axes: Axes, found: list[Interval], arms: list[int], scale: float, digits: int, sign: str = ""
) -> None:
    """Draw a dot with a whisker in each row, and write its value above it.

    `arms` has the index of the arm of each row, which gives its colour. The values are multiplied
    by `scale`. If `sign` is "+", positive values get their sign, too.
    """
    for row, (interval, arm) in enumerate(zip(found, arms, strict=True)):
        value, low, high = (scale * x for x in interval)
        if math.isnan(value):
            continue
        look = style_of(arm)
        if not math.isnan(low):
            axes.plot([low, high], [row, row], color=look.colour, linewidth=2.2, alpha=0.55)
        axes.plot(value, row, marker=look.mark, markersize=7, color=look.colour)
        axes.annotate(
            f"{value:{sign}.{digits}f}", (value, row), (0, 6), textcoords="offset points",
            ha="center", fontsize=8, color=palette.INK,
        )  # fmt: skip
    axes.set_ylim(len(found) - 0.4, -0.75)
    axes.grid(axis="y", visible=False)


def _set_names(axes: Axes, names) -> None:  # type: ignore[no-untyped-def]
    axes.set_yticks(range(len(names)), [shorten(name, MAX_NAME + 8) for name in names])
    for label in axes.get_yticklabels():
        label.set_color(palette.INK)
        label.set_parse_math(False)
