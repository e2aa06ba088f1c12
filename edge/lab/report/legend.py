"""Legend next to the map of a report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from edge.lab.report import palette, path_plot, tasks
from edge.lab.report.marks import dart
from edge.lab.report.record import RunRecord

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def draw(figure: Figure, record: RunRecord, corner: tuple[float, float]) -> None:
    """Draw the legend; its upper left corner is `corner`, in fractions of the figure."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    end_colour = palette.outcome_colour(record.mission.phase)

    def mark(label: str, marker: Any, face: str, edge: str, size: float = 9) -> Line2D:
        """Return an entry with a marker: its label, shape, fill, rim and size."""
        style = {"markerfacecolor": face, "markeredgecolor": edge, "markersize": size}
        return Line2D([], [], ls="", marker=marker, markeredgewidth=1.6, label=label, **style)

    seen = [
        mark("target seen here", "o", palette.TARGET, "white", 8),
        mark("other instance", "o", palette.OBJECT, "white", 7),
    ]
    if path_plot.is_coloured_by_target(record):
        reached = palette.OUTCOME["reached"]
        seen = [mark("reached, numbered in order", "o", reached, "white", 12)]
    handles = [
        Patch(facecolor=palette.FREE, edgecolor="#b8c0cc", label="free"),
        Patch(facecolor=palette.OCCUPIED, label="occupied"),
        Patch(facecolor=palette.INFLATED, label="too close to pass"),
        Patch(facecolor=palette.UNKNOWN, edgecolor="#b8c0cc", label="unknown"),
        mark("frontier at the end", "s", palette.FRONTIER, palette.FRONTIER, 6),
        mark("goal: frontier", "D", "white", palette.FRONTIER),
        mark("goal: instance", "*", "white", palette.TARGET, 14),
        mark("goal: place", "s", "white", palette.TARGET),
        mark("goal: spin", "o", "white", palette.MUTED, 5),
        *seen,
        mark("rejected", "o", palette.MUTED, "white", 7),
        mark("robot at the start", dart(math.pi / 2), "white", palette.START, 13),
        mark("robot at the end", dart(math.pi / 2), end_colour, "white", 13),
    ]
    handles += optional_entries(record)
    legend = figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=corner,
        frameon=False,
        fontsize=9.5,
        labelspacing=0.75,
    )
    for text in legend.get_texts():
        text.set_color(palette.INK)


def optional_entries(record: RunRecord) -> list[Artist]:
    """Return the entries that not every report has: a task's trajectories, rooms, places, zones."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    lines: list[Artist] = []
    if record.task is not None:
        dotted = (0, (1.2, 1.6))
        lines += [
            Line2D([], [], color=tasks.REFINED, lw=6, alpha=0.45, label="refined trajectory"),
            Line2D([], [], color=tasks.COARSE, lw=1.6, ls=dotted, label="coarse trajectory"),
        ]
    if record.rooms:
        lines.append(Line2D([], [], color=palette.ROOM, lw=1.2, ls=(0, (1, 2)), label="room"))
    if record.site.places:
        style = {"markerfacecolor": palette.PLACE, "markeredgecolor": "white", "markersize": 8}
        lines.append(Line2D([], [], ls="", marker="o", label="place", **style))
    for kind in sorted({zone.kind for zone in record.site.zones}):
        colour, label = palette.ZONES[kind], f"{kind.replace('_', '-')} zone"
        lines.append(Patch(facecolor=f"{colour}24", edgecolor=colour, ls="--", label=label))
    if record.objects:
        style = {"markerfacecolor": "white", "markeredgecolor": palette.OBJECT, "markersize": 6}
        lines.append(Line2D([], [], ls="", marker="s", label="remembered object", **style))
    return lines
