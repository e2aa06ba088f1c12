"""Pictures for `edge eval trajectories`: references and the methods' trajectories from above."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edge.lab.eval.trajectories.outcomes import EpisodeFacts, TrajectoryResults
from edge.lab.eval.trajectories.references import KINDS
from edge.lab.report import canvas, palette
from edge.lab.report.canvas import style_of
from edge.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2  # pictures in a row
SIDE_IN = 3.7  # side of a picture
MARGIN_M = 3.0  # around the reference
_GREY = "#b9b9b9"  # of the reference
_MAX_TITLE = 60  # characters


def figures(results: TrajectoryResults) -> dict[str, Figure]:
    """Return each picture by name; {} without outcomes."""
    chosen = choose_episodes(results)
    if not chosen:
        return {}
    rows = math.ceil(len(chosen) / COLUMNS)
    figure, axes = canvas.plots((COLUMNS * SIDE_IN, rows * SIDE_IN + 0.4), COLUMNS, rows)
    for place, ax in enumerate(axes):
        if place < len(chosen):
            _draw(ax, results, chosen[place])
        else:
            ax.axis("off")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False,
                  fontsize=8)  # fmt: skip
    return {"episodes": figure}


def choose_episodes(results: TrajectoryResults) -> list[int]:
    """Return the first episode of each kind that all methods ran, in the order of `KINDS`."""
    run_by_all = np.flatnonzero(results.ran.all(axis=0)).tolist() if results.ran.size else []
    kinds = [results.facts[e].kind for e in run_by_all]
    return [run_by_all[kinds.index(kind)] for kind in KINDS if kind in kinds]


def _draw(axes: Axes, results: TrajectoryResults, episode: int) -> None:
    facts = results.facts[episode]
    for outline in facts.occupied:
        axes.fill(*np.array(outline).T, color=palette.INFLATED, linewidth=0)
    for outline in facts.things:
        axes.fill(*np.array(outline).T, facecolor="none", edgecolor=palette.INK, linewidth=1.4)
    axes.plot(*np.array(facts.reference).T, color=_GREY, linewidth=5.0, solid_capstyle="round",
              label="reference")  # fmt: skip
    for m, name in enumerate(results.methods):
        look, outcome = style_of(m), results.outcomes[m, episode]
        points = np.array(outcome.path)
        axes.plot(*points.T, color=look.colour, linestyle=look.dash, linewidth=1.5, label=name)
        axes.plot(*points[-1], color=look.colour, marker=look.mark, markersize=5)
    axes.plot(*facts.reference[0], color=palette.INK, marker="o", markersize=4)
    _frame(axes, facts)
    axes.set_title(
        shorten(facts.instruction, _MAX_TITLE), loc="left", fontsize=8, color=palette.INK,
        parse_math=False,
    )  # fmt: skip


def _frame(axes: Axes, facts: EpisodeFacts) -> None:
    """Show a square around the reference."""
    points = np.array(facts.reference)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.5 * float(np.ptp(points, axis=0).max()) + MARGIN_M
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
