"""The map of a run as a PNG: where the robot went, what it saw, and what it chose."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from edge.report import palette, raster
from edge.report.files import write_atomically
from edge.sinks.recorder import RunRecord
from edge.types import Instance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.markers import MarkerStyle

Rect = tuple[float, float, float, float]
MAX_LABELS = 24
MAX_PROMINENT = 3
DPI = 110
MAP_IN = (9.1, 8.3)
LEFT_IN, TOP_IN, BOTTOM_IN, SIDE_IN, MIN_HEIGHT_IN = 0.4, 1.0, 0.45, 3.0, 6.6
INCHES_PER_M = 0.55


GOAL_STYLES = {
    "frontier": (palette.FRONTIER, "D", 120),
    "instance": (palette.TARGET, "*", 190),
    "look": (palette.MUTED, "o", 28),
}


class Layout(NamedTuple):
    """Sizes in inches; the map's shape decides the picture's.

    Attributes:
        marks: how large marks are drawn, 1 in a small house and less on larger maps.
    """

    width: float
    height: float
    map_width: float
    map_height: float
    marks: float

    def place(self, left: float, top: float, width: float, height: float) -> Rect:
        """A box given from the upper left corner, as matplotlib wants it."""
        bottom = self.height - top - height
        return (left / self.width, bottom / self.height, width / self.width, height / self.height)


def draw(record: RunRecord, path: Path) -> None:
    """Draw `record` into the PNG file `path`; what it does not have is left out.

    Raises:
        OSError: the file cannot be written.
    """
    write_atomically(path, png(record))


def png(record: RunRecord) -> bytes:
    """The picture as a PNG file's content."""
    import io

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    box = _view(record)
    layout = _layout(box)
    figure = Figure(figsize=(layout.width, layout.height), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes(layout.place(LEFT_IN, TOP_IN, layout.map_width, layout.map_height))
    _frame(axes, box)
    _map(axes, record)
    _frontiers(axes, record, layout.marks)
    _trajectory(figure, axes, record, layout)
    _goals(axes, record, layout.marks)
    _instances(axes, record, layout.marks)
    _poses(axes, record)
    _scale_bar(axes, box)
    _title(figure, record, layout)
    _legend(figure, record, layout)
    out = io.BytesIO()
    canvas.print_png(out)
    return out.getvalue()


def _layout(box: raster.Box) -> Layout:
    shape = (box[3] - box[2]) / (box[1] - box[0])
    width, height = MAP_IN
    if shape * width > height:
        width = max(height / shape, 5.0)
    else:
        height = shape * width
    whole = max(TOP_IN + height + BOTTOM_IN, MIN_HEIGHT_IN)
    per_m = min(width / (box[1] - box[0]), height / (box[3] - box[2]))
    marks = min(1.0, max(0.3, per_m / INCHES_PER_M))
    return Layout(LEFT_IN + width + SIDE_IN, whole, width, height, marks)


def _view(record: RunRecord) -> raster.Box:
    """What the picture shows, in m: everything there is, with a margin and at least 4 m."""
    xs, ys = [np.zeros(0)], [np.zeros(0)]
    for points in (record.trajectory, record.frontiers_m, *_footprints(record)):
        xs.append(np.asarray(points, dtype=np.float64)[:, 0])
        ys.append(np.asarray(points, dtype=np.float64)[:, 1])
    for goal in record.goals:
        xs.append(np.array([goal.pose.x_m, goal.candidate_xy_m[0]]))
        ys.append(np.array([goal.pose.y_m, goal.candidate_xy_m[1]]))
    known = raster.crop(record.map) if record.map is not None else None
    if known is not None:
        x_min, x_max, y_min, y_max = raster.box_of(known)
        xs.append(np.array([x_min, x_max]))
        ys.append(np.array([y_min, y_max]))
    (x_min, x_max), (y_min, y_max) = _span(np.concatenate(xs)), _span(np.concatenate(ys))
    return (x_min, x_max, y_min, y_max)


def _span(values: np.ndarray) -> tuple[float, float]:
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    margin = max(0.4, 2.0 - (high - low) / 2)
    return low - margin, high + margin


def _footprints(record: RunRecord) -> list[np.ndarray]:
    return [instance.points_m for instance in record.instances if len(instance.points_m)]


def _frame(axes: Axes, box: raster.Box) -> None:
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_aspect("equal", anchor="N")
    axes.set_facecolor(palette.UNKNOWN)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#b8c0cc")


def _map(axes: Axes, record: RunRecord) -> None:
    known = raster.crop(record.map) if record.map is not None else None
    if known is None:
        axes.text(
            0.5, 0.5, "nothing mapped", transform=axes.transAxes, ha="center", color=palette.MUTED
        )
        return
    cells, k = raster.thin(known.cells)
    (h, w), (x_m, y_m), step_m = cells.shape, known.origin_xy_m, k * known.resolution_m
    extent = (x_m, x_m + w * step_m, y_m, y_m + h * step_m)
    image = raster.colour(cells)
    axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=0)


def _frontiers(axes: Axes, record: RunRecord, marks: float) -> None:
    style = {"s": 22 * marks, "marker": "s", "color": palette.FRONTIER, "zorder": 2}
    axes.scatter(record.frontiers_m[:, 0], record.frontiers_m[:, 1], **style)


def _trajectory(figure: Figure, axes: Axes, record: RunRecord, layout: Layout) -> None:
    """The path, coloured by time, on a white casing that keeps it off the map."""
    from matplotlib.collections import LineCollection

    if len(record.trajectory) < 2:
        return
    points = record.trajectory[:, :2]
    seconds = record.trajectory_t_s
    axes.plot(points[:, 0], points[:, 1], color="white", lw=5.0, zorder=3, solid_capstyle="round")
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(segments), cmap="viridis", lw=2.6, zorder=4, capstyle="round")
    lines.set_array(seconds[1:])
    lines.set_clim(0.0, max(float(seconds[-1]), 1e-3))
    axes.add_collection(lines)
    place = layout.place(LEFT_IN + layout.map_width + 0.3, TOP_IN + 3.3, 0.17, 1.8)
    bar = figure.colorbar(lines, cax=figure.add_axes(place))
    bar.set_label("time of the path, s", color=palette.MUTED, fontsize=9)
    bar.ax.tick_params(labelsize=8, colors=palette.MUTED)
    bar.outline.set_visible(False)


def _goals(axes: Axes, record: RunRecord, marks: float) -> None:
    """Each goal's pose, numbered where there is room, with a thin line to its candidate."""
    numbered: list[tuple[float, float]] = []
    for number, goal in enumerate(record.goals, start=1):
        colour, marker, size = GOAL_STYLES[goal.kind]
        x_m, y_m = goal.pose.x_m, goal.pose.y_m
        across, along = zip((x_m, y_m), goal.candidate_xy_m, strict=True)
        axes.plot(across, along, color=colour, lw=0.9, alpha=0.7, zorder=5)
        style = {"color": "white", "edgecolor": colour, "linewidth": 1.6, "zorder": 6}
        axes.scatter(x_m, y_m, s=size * marks, marker=marker, **style)
        crowded = any(math.dist(xy_m, (x_m, y_m)) < 0.25 for xy_m in numbered)
        if goal.kind == "frontier" and marks > 0.7 and not crowded:
            numbered.append((x_m, y_m))
            style = {"ha": "center", "va": "center_baseline", "fontsize": 7}
            axes.text(x_m, y_m, str(number), color=palette.INK, zorder=6.5, **style)


def _instances(axes: Axes, record: RunRecord, marks: float) -> None:
    """Surface points of every instance; labels where there is room, the target's first."""
    ranked = sorted(record.instances, key=lambda i: _rank(record, i))
    taken: list[raster.Box] = []
    for rank, instance in enumerate(ranked):
        wanted = _rank(record, instance)[0] == 0
        colour = palette.TARGET if wanted else palette.INSTANCE
        colour = palette.MUTED if instance.state == "refuted" else colour
        points = instance.points_m
        if len(points):
            style = {"s": 7 * marks, "color": colour, "alpha": 0.55, "lw": 0, "zorder": 5}
            axes.scatter(points[:, 0], points[:, 1], **style)
        xy_m = (float(instance.center_m[0]), float(instance.center_m[1]))
        style = {"color": colour, "edgecolor": "white", "zorder": 8}
        axes.scatter(*xy_m, s=(46 if wanted else 26) * marks, **style)
        if rank < MAX_LABELS:
            state = f" ({instance.state})" if instance.state in ("confirmed", "reached") else ""
            words = f"{instance.label} {instance.score:.2f}{state}"
            _label(axes, words, xy_m, colour, taken, prominent=wanted and rank < MAX_PROMINENT)


def _rank(record: RunRecord, instance: Instance) -> tuple[int, bool, float]:
    """What is labelled first: the target, found before guessed, then the surest."""
    refuted = instance.state == "refuted"
    order = 2 if refuted else 0 if record.is_target(instance.label) else 1
    return order, instance.state != "reached", -instance.score


def _label(
    axes: Axes,
    words: str,
    xy_m: tuple[float, float],
    colour: str,
    taken: list[raster.Box],
    prominent: bool,
) -> None:
    """Text beside a point, at the first of several places that is inside the map and covers no
    earlier label; without such a place none, unless it is prominent."""
    size = 10.5 if prominent else 8.0
    width, height = 0.57 * size * len(words) + 8, 1.5 * size
    to_points = 72.0 / axes.figure.dpi
    x, y = (float(v) * to_points for v in axes.transData.transform(xy_m))
    places = [(dx, dy) for dy in (9, -9 - height, 22, -22 - height) for dx in (7, -7 - width)]
    inside = axes.get_window_extent()
    limits = (inside.x0 * to_points, inside.x1 * to_points)
    for dx, dy in places:
        box = (x + dx, x + dx + width, y + dy, y + dy + height)
        fits = box[0] >= limits[0] and box[1] <= limits[1]
        if fits and not any(_overlap(box, other) for other in taken):
            break
    else:
        if not prominent:
            return
        dx, dy = places[0]
    taken.append((x + dx, x + dx + width, y + dy, y + dy + height))
    axes.annotate(
        _plain(words),
        xy_m,
        xytext=(dx + width / 2, dy + height / 2),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=size,
        color="white",
        fontweight="bold" if prominent else "normal",
        bbox={"boxstyle": "round,pad=0.22", "facecolor": colour, "edgecolor": "white", "lw": 0.8},
        zorder=10.5 if prominent else 9,
    )


def _overlap(a: raster.Box, b: raster.Box) -> bool:
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]


def _plain(text: str) -> str:
    """Text that matplotlib must not read as mathematics."""
    return text.replace("$", r"\$")


def _poses(axes: Axes, record: RunRecord) -> None:
    """The robot at the start (outlined) and at the end (filled), as arrow heads."""
    if not len(record.trajectory):
        return
    end = palette.outcome_colour(record.mission.phase)
    for pose, face, edge in ((0, "white", palette.START), (-1, end, "white")):
        x_m, y_m, yaw_rad = record.trajectory[pose]
        marker = _dart(yaw_rad)
        axes.scatter(x_m, y_m, s=420, marker=marker, color=face, edgecolor=edge, lw=1.8, zorder=10)


def _dart(yaw_rad: float) -> MarkerStyle:
    """A marker that points along `yaw_rad`."""
    from matplotlib.markers import MarkerStyle
    from matplotlib.path import Path as Outline

    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    dart = np.array([(1.0, 0.0), (-0.75, 0.7), (-0.35, 0.0), (-0.75, -0.7), (1.0, 0.0)])
    return MarkerStyle(Outline(dart @ np.array([(c, s), (-s, c)]), closed=True))


def _scale_bar(axes: Axes, box: raster.Box) -> None:
    """A round length below the map, where it covers nothing."""
    from matplotlib.transforms import ScaledTranslation

    span_m = box[1] - box[0]
    length_m = max(s for s in (0.5, 1, 2, 5, 10, 20, 50, 100) if s <= max(0.5, span_m / 5))
    ends, y_m = (box[0], box[0] + length_m), box[2]
    below = axes.transData + ScaledTranslation(0.0, -0.15, axes.figure.dpi_scale_trans)
    style = {"color": palette.INK, "lw": 3, "solid_capstyle": "butt", "transform": below}
    axes.plot(ends, (y_m, y_m), clip_on=False, **style)
    style = {"va": "center", "fontsize": 9, "color": palette.INK, "annotation_clip": False}
    offset = (6.0, -0.15 * 72)
    axes.annotate(f"{length_m:g} m", (ends[1], y_m), offset, textcoords="offset points", **style)


def _title(figure: Figure, record: RunRecord, layout: Layout) -> None:
    def y(from_top: float) -> float:
        return 1.0 - from_top / layout.height

    phase = record.mission.phase
    box = {"boxstyle": "round,pad=0.4", "facecolor": palette.outcome_colour(phase), "lw": 0}
    style = {"color": "white", "fontsize": 13, "fontweight": "bold", "va": "center", "bbox": box}
    badge = figure.text((LEFT_IN + 0.1) / layout.width, y(0.5), phase.upper(), **style)
    right_px = badge.get_window_extent(figure.canvas.get_renderer()).x1
    x = (right_px / DPI + 0.25) / layout.width
    style = {"fontsize": 16, "fontweight": "bold", "va": "center", "color": palette.INK}
    room_in = layout.width * (1.0 - x) - 0.1
    figure.text(x, y(0.38), _plain(_cut(record.title, room_in / 0.148)), **style)
    style = {"fontsize": 10, "va": "center", "color": palette.MUTED}
    figure.text(x, y(0.67), _plain(_cut(subtitle(record), room_in / 0.082)), **style)


def _cut(text: str, length: float) -> str:
    return text if len(text) <= length else f"{text[: int(length) - 1]}…"


def subtitle(record: RunRecord) -> str:
    """Time, path, map and, where it failed, why: in one line."""
    mission = record.mission
    parts = [f"{mission.elapsed_s:.1f} s", f"{mission.path_m:.1f} m driven"]
    if record.map is not None:
        parts.append(f"{record.map.known_m2:.0f} m² mapped")
    parts.append(f"{len(record.goals)} goals")
    if mission.reason:
        parts.append(mission.reason)
    return " · ".join(parts)


def _legend(figure: Figure, record: RunRecord, layout: Layout) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    end = palette.outcome_colour(record.mission.phase)

    def mark(label: str, marker: Any, face: str, edge: str, size: float = 9) -> Line2D:
        style = {"markerfacecolor": face, "markeredgecolor": edge, "markersize": size}
        return Line2D([], [], ls="", marker=marker, markeredgewidth=1.6, label=label, **style)

    handles = [
        Patch(facecolor=palette.FREE, edgecolor="#b8c0cc", label="free"),
        Patch(facecolor=palette.OCCUPIED, label="occupied"),
        Patch(facecolor=palette.INFLATED, label="too close to pass"),
        Patch(facecolor=palette.UNKNOWN, edgecolor="#b8c0cc", label="unknown"),
        mark("frontier at the end", "s", palette.FRONTIER, palette.FRONTIER, 6),
        mark("goal: frontier", "D", "white", palette.FRONTIER),
        mark("goal: instance", "*", "white", palette.TARGET, 14),
        mark("turn to look", "o", "white", palette.MUTED, 5),
        mark("target seen here", "o", palette.TARGET, "white", 8),
        mark("other instance", "o", palette.INSTANCE, "white", 7),
        mark("refuted", "o", palette.MUTED, "white", 7),
        mark("robot at the start", _dart(math.pi / 2), "white", palette.START, 13),
        mark("robot at the end", _dart(math.pi / 2), end, "white", 13),
    ]
    legend = figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=layout.place(LEFT_IN + layout.map_width + 0.1, TOP_IN - 0.1, 0.0, 0.0)[:2],
        frameon=False,
        fontsize=9.5,
        labelspacing=0.75,
    )
    for text in legend.get_texts():
        text.set_color(palette.INK)
