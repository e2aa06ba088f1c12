"""Map of a run as a PNG: the robot's path, the objects it saw, and its goals."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from edge.geometry import downsample
from edge.lab.report import legend, marks, palette, path_plot, raster, tasks
from edge.lab.report.canvas import content
from edge.lab.report.path_plot import Rect
from edge.lab.report.record import RunRecord
from edge.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 110
MAP_IN = (9.1, 8.3)  # largest width and height of the map
LEFT_IN, TOP_IN, BOTTOM_IN = 0.4, 1.0, 0.45  # margins of the map
SIDE_IN = 3.0  # width of the legend, right of the map
MIN_HEIGHT_IN = 6.8  # of the picture, so that the legend has room
INCHES_PER_M = 0.55  # scale of a map whose marks have full size
LINE_IN = 0.275
"""Height of a line of the legend."""


class MapLayout(NamedTuple):
    """Sizes in inches; the map's shape decides the picture's.

    Attributes:
        marks: scale of the marks: 1 in a small house, down to 0.3 on larger maps.
    """

    width: float
    height: float
    map_width: float
    map_height: float
    marks: float

    def place(self, left: float, top: float, width: float, height: float) -> Rect:
        """Return a box, given from the upper left corner, in matplotlib's figure fractions."""
        bottom = self.height - top - height
        return (left / self.width, bottom / self.height, width / self.width, height / self.height)


def png(record: RunRecord) -> bytes:
    """Return the map as the content of a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    box = _shown_area(record)
    n_more = len(legend.optional_entries(record))
    layout = _layout(box, n_more)
    figure = Figure(figsize=(layout.width, layout.height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes(layout.place(LEFT_IN, TOP_IN, layout.map_width, layout.map_height))
    _set_view(axes, box)
    _draw_map(axes, record)
    _draw_frontiers(axes, record, layout.marks)
    marks.rooms(axes, record)
    marks.zones(axes, record)
    tasks.draw(axes, record)
    # The path's legend is below the entries of every report (3.3 inches) and the optional ones.
    right, below_in = LEFT_IN + layout.map_width, 3.3 + LINE_IN * n_more
    path_plot.draw(figure, axes, record, layout.place(right + 0.3, TOP_IN + below_in, 0.17, 1.8))
    marks.goals(axes, record, layout.marks)
    taken: list[raster.Box] = []
    marks.instances(axes, record, layout.marks, taken)
    marks.places(axes, record, taken)
    marks.objects(axes, record, layout.marks, taken)
    marks.poses(axes, record)
    _draw_scale_bar(axes, box)
    _draw_title(figure, record, layout)
    legend.draw(figure, record, layout.place(right + 0.1, TOP_IN - 0.1, 0.0, 0.0)[:2])
    return content(figure, "png")


def _layout(box: raster.Box, n_more: int) -> MapLayout:
    """Return the sizes for a shown area; `n_more`: number of optional entries of the legend."""
    x_min, x_max, y_min, y_max = box
    shape = (y_max - y_min) / (x_max - x_min)
    width, height = MAP_IN
    if shape * width > height:
        width = max(height / shape, 5.0)
    else:
        height = shape * width
    picture_height = max(TOP_IN + height + BOTTOM_IN, MIN_HEIGHT_IN + LINE_IN * n_more)
    per_m = min(width / (x_max - x_min), height / (y_max - y_min))
    scale = min(1.0, max(0.3, per_m / INCHES_PER_M))
    return MapLayout(LEFT_IN + width + SIDE_IN, picture_height, width, height, scale)


def _shown_area(record: RunRecord) -> raster.Box:
    """Return the shown area [m]: everything in the record with a margin, at least 4 m."""
    xs, ys = [np.zeros(0)], [np.zeros(0)]
    footprints = [instance.points_m for instance in record.instances if len(instance.points_m)]
    shown = (record.trajectory, record.frontiers_m, *footprints, *tasks.points_m(record))
    for points in shown:
        xs.append(np.asarray(points, dtype=np.float64)[:, 0])
        ys.append(np.asarray(points, dtype=np.float64)[:, 1])
    for goal in record.goals:
        xs.append(np.array([goal.pose.x_m, goal.candidate_xy_m[0]]))
        ys.append(np.array([goal.pose.y_m, goal.candidate_xy_m[1]]))
    known = raster.crop(record.map) if record.map is not None else None
    if known is not None:
        x_min, x_max, y_min, y_max = known.extent_m
        xs.append(np.array([x_min, x_max]))
        ys.append(np.array([y_min, y_max]))
    (x_min, x_max), (y_min, y_max) = (
        _with_margin(np.concatenate(xs)),
        _with_margin(np.concatenate(ys)),
    )
    return (x_min, x_max, y_min, y_max)


def _with_margin(values: np.ndarray) -> tuple[float, float]:
    """Return the range of the values with a margin of 0.4 m or more, at least 4 m long."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    margin = max(0.4, 2.0 - (high - low) / 2)
    return low - margin, high + margin


def _set_view(axes: Axes, box: raster.Box) -> None:
    """Set the shown area, with equal scales and no ticks."""
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_aspect("equal", anchor="N")
    axes.set_facecolor(palette.UNKNOWN)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#b8c0cc")


def _draw_map(axes: Axes, record: RunRecord) -> None:
    """Draw the known part of the occupancy grid."""
    known = raster.crop(record.map) if record.map is not None else None
    if known is None:
        axes.text(
            0.5, 0.5, "nothing mapped", transform=axes.transAxes, ha="center", color=palette.MUTED
        )
        return
    thinned = downsample(known, raster.MAX_SIDE_PX)
    image, extent = raster.colour(thinned.cells), thinned.extent_m
    axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=0)


def _draw_frontiers(axes: Axes, record: RunRecord, scale: float) -> None:
    style = {"s": 22 * scale, "marker": "s", "color": palette.FRONTIER, "zorder": 2}
    axes.scatter(record.frontiers_m[:, 0], record.frontiers_m[:, 1], **style)


def _draw_scale_bar(axes: Axes, box: raster.Box) -> None:
    """Draw a scale bar of a round length below the map, where it covers nothing."""
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


def _draw_title(figure: Figure, record: RunRecord, layout: MapLayout) -> None:
    """Draw the outcome as a badge, and next to it the title with a line of figures below."""

    def y(from_top: float) -> float:
        """Return a distance from the upper edge [inches] as a fraction of the figure."""
        return 1.0 - from_top / layout.height

    phase = record.mission.phase
    box = {"boxstyle": "round,pad=0.4", "facecolor": palette.outcome_colour(phase), "lw": 0}
    style = {"color": "white", "fontsize": 13, "fontweight": "bold", "va": "center", "bbox": box}
    badge = figure.text((LEFT_IN + 0.1) / layout.width, y(0.5), phase.upper(), **style)
    right_px = badge.get_window_extent(figure.canvas.get_renderer()).x1
    x = (right_px / DPI + 0.25) / layout.width
    style = {"fontsize": 16, "fontweight": "bold", "va": "center", "color": palette.INK}
    # Both lines are cut to the width that is left, by the mean width of a character.
    width_in = layout.width * (1.0 - x) - 0.1
    figure.text(x, y(0.38), marks.plain(shorten(record.title, int(width_in / 0.148))), **style)
    style = {"fontsize": 10, "va": "center", "color": palette.MUTED}
    figure.text(x, y(0.67), marks.plain(shorten(subtitle(record), int(width_in / 0.082))), **style)


def subtitle(record: RunRecord) -> str:
    """Return time, path and mapped area in one line, and the reason of a failure."""
    mission = record.mission
    parts = [f"{mission.elapsed_s:.1f} s", f"{mission.path_m:.1f} m driven"]
    if record.map is not None:
        parts.append(f"{record.map.known_m2:.0f} m² mapped")
    parts.append(f"{len(record.goals)} goals")
    if mission.reason:
        parts.append(mission.reason)
    return " · ".join(parts)
