"""Picture of a task's trajectory from above, as in OpenNav's figure 4.

It has one or two panels: the scene, and the cost of each cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.geometry import Grid
from edge.lab.report import canvas, palette
from edge.lab.report.view3d import OCCUPIED, UNKNOWN, UNKNOWN_RGB, ground_colours
from edge.tasks.refine import RefinedTrajectory
from edge.tasks.scene.picture import colour
from edge.tasks.scene.scene import Scene, SceneObject
from edge.tasks.scene.value_map import BRIDGE, DRIVABLE, HIGH, TUBE
from edge.trajectory.costmap import CostMap

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

COARSE, REFINED = "#e67700", palette.TARGET  # colours of the trajectories
MARGIN_M = 5.0  # margin around the trajectory
LEAST_M = 24.0  # shortest side of the shown area
WIDTH_IN = 8.4  # width of the figure
MOST_HIGH_IN = 6.0  # largest height of a panel
DPI = 120
_LEGEND_IN = 0.27
"""Distance of the legend below a panel."""
_LEGEND_COLUMNS = {1: 7, 2: 2}
"""Columns of the legend, by the number of panels side by side. A wider legend would shrink its
panel."""
_LEGEND_ROW_IN = 0.17
# Weight of a cell in the cost map -> its meaning and its colour.
_VALUES = {
    TUBE: ("near the coarse trajectory", "#8ce99a"),
    DRIVABLE: ("chosen ground", "#d3f9d8"),
    BRIDGE: ("not seen, but next to seen ground", "#fff3bf"),
    HIGH: ("other ground", "#ffe8cc"),
    0: ("closed: near an obstacle, or not seen", "#4a5361"),
}
_Box = tuple[float, float, float, float]
"""(x_min, x_max, y_min, y_max) in metres of `map`."""


def png(
    scene: Scene,
    coarse_m: np.ndarray | None,
    refined: RefinedTrajectory | None,
    costmap: CostMap | None,
) -> bytes:
    """Return the content of a PNG file: the scene and, next to it or below, the cost of each cell.

    The scene shows regions, objects and their numbers. Both panels show the coarse trajectory, (n,
    2) float64 in `map`, and the refined one, if there are any. Without the cost map that it was
    refined on, there is one panel.
    """
    box = _shown_area(scene, coarse_m, refined)
    wide, high = box[1] - box[0], box[3] - box[2]
    panels = 1 if costmap is None else 2
    rows, columns = (panels, 1) if wide >= high else (1, panels)
    width_in = WIDTH_IN / columns
    high_in = min(MOST_HIGH_IN, width_in * high / wide)
    legends = _legend_handles(scene, coarse_m, refined, box)
    legend_rows = math.ceil(max(map(len, legends[:panels])) / _LEGEND_COLUMNS[columns])
    # 0.41: title and axis numbers.
    high_in += 0.41 + _LEGEND_ROW_IN * max(legend_rows, 2)
    figure, all_axes = canvas.plots((WIDTH_IN, rows * high_in), columns, rows, DPI)
    for axes in all_axes:
        axes.set_xlim(box[:2])
        axes.set_ylim(box[2:])
        axes.set_aspect("equal")
        axes.grid(False)
        axes.xaxis.set_major_formatter("{x:g} m")
        axes.yaxis.set_major_formatter("{x:g} m")
    _draw_scene(all_axes[0], scene)
    if costmap is not None:
        _draw_values(all_axes[1], costmap)
    for axes in all_axes:
        _draw_lines(axes, scene, coarse_m, refined)
    for item in scene.objects.values():
        _draw_object(all_axes[0], item, box)
    for axes, handles in zip(all_axes, legends, strict=False):  # one legend more than panels
        _draw_legend(axes, handles, _LEGEND_COLUMNS[columns])
    return canvas.content(figure, "png")


def _shown_area(
    scene: Scene, coarse_m: np.ndarray | None, refined: RefinedTrajectory | None
) -> _Box:
    """Return the shown area: the robot and the trajectory with a margin.

    Without a trajectory it is the robot and all objects.
    """
    points = [np.array([[scene.pose.x_m, scene.pose.y_m]])]
    points += [] if coarse_m is None else [coarse_m]
    points += [] if refined is None else [refined.poses[:, :2]]
    if coarse_m is None:
        points += [item.position_m[None, :2] for item in scene.objects.values()]
    all_points = np.concatenate(points)
    low, high = all_points.min(axis=0) - MARGIN_M, all_points.max(axis=0) + MARGIN_M
    # Not too narrow: the surroundings of the trajectory matter too.
    missing = np.maximum(np.maximum(LEAST_M, 0.5 * (high - low).max()) - (high - low), 0.0)
    (x0, y0), (x1, y1) = low - 0.5 * missing, high + 0.5 * missing
    return float(x0), float(x1), float(y0), float(y1)


def _draw_scene(axes: Axes, scene: Scene) -> None:
    """Draw the regions of the ground and the obstacles."""
    cells, colours = ground_colours(scene)
    axes.set_facecolor(tuple(v / 255 for v in UNKNOWN_RGB))
    _draw_image(axes, scene.occupancy, colours[cells])
    axes.set_title("Scene", loc="left", color=palette.INK, fontsize=10)


def _draw_values(axes: Axes, costmap: CostMap) -> None:
    """Draw the cost of each cell, by its weight."""
    table = np.zeros((256, 3), np.uint8)
    for weight, (_, css_colour) in _VALUES.items():
        table[weight] = np.frombuffer(bytes.fromhex(css_colour[1:]), np.uint8)
    axes.set_facecolor(_VALUES[0][1])  # outside of the map nothing was seen
    _draw_image(axes, costmap.grid, table[costmap.weight])
    axes.set_title("Cost of each cell", loc="left", color=palette.INK, fontsize=10)


def _draw_image(axes: Axes, grid: Grid, rgb: np.ndarray) -> None:
    if grid.cells.size:
        axes.imshow(
            rgb, origin="lower", extent=grid.extent_m, interpolation="nearest", aspect="equal",
            zorder=0,
        )  # fmt: skip


def _draw_lines(
    axes: Axes, scene: Scene, coarse_m: np.ndarray | None, refined: RefinedTrajectory | None
) -> None:
    """Draw both trajectories, the end's heading and the robot."""
    if coarse_m is not None:
        axes.plot(*coarse_m.T, color=COARSE, lw=1.4, ls=(0, (3, 1.5)), marker=".", ms=3.5, zorder=4)
    if refined is not None:
        x, y, _, heading = refined.poses.T
        axes.plot(x, y, color="white", lw=4.4, solid_capstyle="round", zorder=5)
        axes.plot(x, y, color=REFINED, lw=2.4, solid_capstyle="round", zorder=6)
        _draw_arrow(axes, (x[-1], y[-1]), heading[-1], REFINED)
    _draw_arrow(axes, (scene.pose.x_m, scene.pose.y_m), scene.pose.yaw_rad, palette.START)


def _draw_arrow(axes: Axes, at: tuple[float, float], heading_rad: float, face: str) -> None:
    """Draw a dart that points along a heading."""
    marker = (3, 0, math.degrees(heading_rad) - 90.0)
    style = {"markeredgecolor": "white", "markeredgewidth": 1.2, "zorder": 8, "ls": ""}
    axes.plot(*at, marker=marker, markersize=12, markerfacecolor=face, **style)


def _draw_object(axes: Axes, item: SceneObject, box: _Box) -> None:
    """Draw an object's outline on the ground and its number, in its colour of the camera image."""
    rim = tuple(0.8 * v / 255 for v in colour(item.id))
    along, across = 0.5 * np.maximum(item.size_m[:2], 0.15)
    c, s = math.cos(item.heading_rad), math.sin(item.heading_rad)
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)]) * (along, across)
    xy = corners @ np.array([[c, s], [-s, c]]) + item.position_m[:2]
    axes.plot(*xy.T, color=rim, lw=1.3, zorder=3)
    x, y = item.position_m[:2].tolist()
    if box[0] < x < box[1] and box[2] < y < box[3]:
        face = {"boxstyle": "circle,pad=0.22", "facecolor": "#12161c", "edgecolor": rim, "lw": 1.0}
        axes.text(
            x, y, str(item.id), color="white", fontsize=6.5, ha="center", va="center", bbox=face,
            zorder=7, clip_on=True,
        )  # fmt: skip


def _legend_handles(
    scene: Scene, coarse_m: np.ndarray | None, refined: RefinedTrajectory | None, box: _Box
) -> tuple[list[Artist], list[Artist]]:
    """Return the entries of each panel's legend; contents that are not shown have none."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    cells, colours = ground_colours(scene)
    rows, columns = np.indices(cells.shape)
    centres = scene.occupancy.centres_m(rows, columns)
    inside = (centres[..., 0] > box[0]) & (centres[..., 0] < box[1])
    inside &= (centres[..., 1] > box[2]) & (centres[..., 1] < box[3])
    shown = np.unique(cells[inside])
    named = {region.label: region.id for region in scene.regions.values() if region.id in shown}
    known = {**named, "other ground": 0, "not seen": UNKNOWN, "occupied": OCCUPIED}
    patches = [
        Patch(facecolor=colours[value] / 255, label=label, edgecolor="#b8c0cc", lw=0.6)
        for label, value in known.items()
        if value in shown
    ]
    lines = [Line2D([], [], color=COARSE, lw=1.4, ls=(0, (3, 1.5)), label="coarse")]
    lines += [Line2D([], [], color=REFINED, lw=2.4, label="refined")]
    drawn = [
        line for line, data in zip(lines, (coarse_m, refined), strict=True) if data is not None
    ]
    values = [
        Patch(facecolor=shade, label=label, edgecolor="#b8c0cc", lw=0.6)
        for label, shade in _VALUES.values()
    ]
    return [*patches, *drawn], values


def _draw_legend(axes: Axes, handles: Sequence[Artist], columns: int) -> None:
    """Draw the legend below a panel."""
    from matplotlib.transforms import ScaledTranslation

    below = ScaledTranslation(0.0, -_LEGEND_IN, axes.figure.dpi_scale_trans)
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.0, 0.0),
        bbox_transform=axes.transAxes + below, ncols=columns,
        frameon=False, fontsize=7.5, labelcolor=palette.INK, handlelength=1.4,
        columnspacing=1.1, borderaxespad=0.0,
    )  # fmt: skip
