"""Marks on the map of a report: goals, objects, places and zones with their labels, and the robot.

Each public function draws one kind of mark. `instances` are the objects that the mission looks for,
`objects` the others that the robot remembers. A number as `zorder` says what is on top.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edge import names
from edge.lab.report import palette, raster
from edge.lab.report.record import RunRecord
from edge.text import shorten
from edge.types import Instance, MissionEvent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.markers import MarkerStyle

MAX_LABELS = 24  # most labels of objects
MAX_PROMINENT = 3  # most targets with a large label, not counting those reached
MAX_LABEL = 60  # characters
# Kind of a goal's candidate -> colour, matplotlib's marker, area in square points.
GOAL_STYLES = {
    "frontier": (palette.FRONTIER, "D", 120),
    "instance": (palette.TARGET, "*", 190),
    "spin": (palette.MUTED, "o", 28),
    "place": (palette.TARGET, "s", 100),
    "zone_exit": (palette.MUTED, "s", 60),
}


def goals(axes: Axes, record: RunRecord, scale: float) -> None:
    """Draw each goal's pose, with a thin line to its candidate.

    Goals at frontiers are numbered where there is room. Goals on a task's trajectory are left out:
    they are on its line (`edge.lab.report.tasks`).
    """
    numbered: list[tuple[float, float]] = []
    for number, goal in enumerate(record.goals, start=1):
        if goal.kind == "trajectory":
            continue
        colour, marker, size = GOAL_STYLES[goal.kind]
        if goal.kind == "instance":
            colour = palette.target_colour(goal.target, record.targets)
        x_m, y_m = goal.pose.x_m, goal.pose.y_m
        xs, ys = zip((x_m, y_m), goal.candidate_xy_m, strict=True)
        axes.plot(xs, ys, color=colour, lw=0.9, alpha=0.7, zorder=5)
        style = {"color": "white", "edgecolor": colour, "linewidth": 1.6, "zorder": 6}
        axes.scatter(x_m, y_m, s=size * scale, marker=marker, **style)
        crowded = any(math.dist(xy_m, (x_m, y_m)) < 0.25 for xy_m in numbered)
        if goal.kind == "frontier" and scale > 0.7 and not crowded:
            numbered.append((x_m, y_m))
            style = {"ha": "center", "va": "center_baseline", "fontsize": 7}
            axes.text(x_m, y_m, str(number), color=palette.INK, zorder=6.5, **style)


def rooms(axes: Axes, record: RunRecord) -> None:
    """Draw the outline of every room, with its name or kind in the middle."""
    for room in record.rooms:
        if not len(room.polygon_m):
            continue
        style = {"fill": False, "edgecolor": palette.ROOM, "lw": 1.2, "ls": (0, (1, 2))}
        axes.fill(*room.polygon_m.T, zorder=2.5, **style)
        style = {"ha": "center", "va": "center", "fontsize": 9, "clip_on": True, "zorder": 4}
        axes.text(*room.xy_m, plain(shorten(room.title, MAX_LABEL)), color=palette.ROOM, **style)


def zones(axes: Axes, record: RunRecord) -> None:
    """Draw the outline of every zone, with its name at the upper left corner."""
    for zone in record.site.zones:
        xs, ys = zip(*zone.corners_m, strict=True)
        colour = palette.ZONES[zone.kind]
        if zone.kind == "keep_out":
            axes.fill(xs, ys, facecolor=colour, alpha=0.14, zorder=1)
        axes.fill(xs, ys, fill=False, edgecolor=colour, lw=1.6, ls=(0, (4, 2)), zorder=3)
        x_m, y_m = max(zone.corners_m, key=lambda corner: (corner[1], -corner[0]))
        style = {"textcoords": "offset points", "va": "top", "fontsize": 8.5, "zorder": 9}
        name = plain(shorten(zone.name, MAX_LABEL))
        axes.annotate(
            name, (x_m, y_m), (4, -4), color=colour, fontweight="bold", clip_on=True, **style
        )


def places(axes: Axes, record: RunRecord, taken: list[raster.Box]) -> None:
    """Draw every place as a disc with a tick along its heading, and labels if there is room.

    `taken` is the space of labels, see `instances`.
    """
    for place in record.site.places:
        pose = place.pose
        tip_m = pose.x_m + 0.3 * math.cos(pose.yaw_rad), pose.y_m + 0.3 * math.sin(pose.yaw_rad)
        ends = zip((pose.x_m, pose.y_m), tip_m, strict=True)
        axes.plot(*ends, color=palette.PLACE, lw=2.2, zorder=7)
        style = {"s": 44, "color": palette.PLACE, "edgecolor": "white", "zorder": 7.5}
        axes.scatter(pose.x_m, pose.y_m, **style)
        name = shorten(place.name, MAX_LABEL)
        _label(axes, name, (pose.x_m, pose.y_m), palette.PLACE, taken, False)


def objects(axes: Axes, record: RunRecord, scale: float, taken: list[raster.Box]) -> None:
    """Draw remembered objects of other names than the instances, and labels if there is room.

    `scale` and `taken` are as for `instances`.
    """
    drawn_names = {instance.label for instance in record.instances}
    for obj in [obj for obj in record.objects if obj.name not in drawn_names][:MAX_LABELS]:
        xy_m = obj.xyz_m[:2]
        style = {"color": "white", "edgecolor": palette.OBJECT, "linewidth": 1.2, "zorder": 4.5}
        axes.scatter(*xy_m, s=24 * scale, marker="s", **style)
        _label(axes, shorten(obj.name, MAX_LABEL), xy_m, palette.MUTED, taken, False)


def instances(axes: Axes, record: RunRecord, scale: float, taken: list[raster.Box]) -> None:
    """Draw the surface points of every instance, and labels if there is room."""
    numbers = _order_reached(record)
    ranked = sorted(record.instances, key=lambda i: _rank(record, i))
    for rank, instance in enumerate(ranked):
        is_wanted = _rank(record, instance)[0] == _TARGET_RANK
        colour = palette.target_colour(instance.label, record.targets)
        colour = palette.MUTED if instance.state == "rejected" else colour
        number = numbers.get(instance.id, "")
        points = instance.points_m
        if len(points):
            style = {"s": 7 * scale, "color": colour, "alpha": 0.55, "lw": 0, "zorder": 5}
            axes.scatter(points[:, 0], points[:, 1], **style)
        xy_m = (float(instance.center_m[0]), float(instance.center_m[1]))
        style = {"color": colour, "edgecolor": "white", "zorder": 8}
        if number:
            _number(axes, number, xy_m)
        else:
            axes.scatter(*xy_m, s=(46 if is_wanted else 26) * scale, **style)
        if rank < MAX_LABELS:
            state = f" ({instance.state})" if instance.state in ("confirmed", "reached") else ""
            words = f"{shorten(instance.label, MAX_LABEL)} {instance.score:.2f}{state}"
            prominent = bool(number) or (is_wanted and rank < MAX_PROMINENT)
            _label(axes, words, xy_m, colour, taken, prominent)


def _order_reached(record: RunRecord) -> dict[int, str]:
    """Map ids of reached instances to "1", "2", … in the order of reaching.

    If several instances of a name were reached, the one nearest to the robot at that time counts.
    The result is empty for a mission with a single target.
    """
    numbers: dict[int, str] = {}
    if record.has_single_target:
        return numbers
    for number, step in enumerate(record.reached, start=1):
        reached = [i for i in record.instances if i.state == "reached" and _has_name(i, step.label)]
        if reached:
            nearest = min(reached, key=lambda i: _distance_m(record, step, i))
            before = numbers.get(nearest.id)
            numbers[nearest.id] = f"{before}, {number}" if before else f"{number}"
    return numbers


def _has_name(instance: Instance, label: str) -> bool:
    return names.same_name(instance.label, label)


def _distance_m(record: RunRecord, step: MissionEvent, instance: Instance) -> float:
    """Return the distance of an instance from the robot at the time of an event."""
    if not len(record.trajectory):
        return 0.0
    last = len(record.trajectory) - 1
    k = min(last, int(np.searchsorted(record.trajectory_t_s, record.seconds(step.stamp_ns))))
    return math.dist(record.trajectory[k, :2], instance.center_m[:2])


def _number(axes: Axes, number: str, xy_m: tuple[float, float]) -> None:
    """Draw a disc with the number in the order of reaching."""
    style = {"color": palette.OUTCOME["reached"], "edgecolor": "white", "lw": 1.4, "zorder": 11}
    axes.scatter(*xy_m, s=260, **style)
    size = 10 if len(number) < 3 else 7
    style = {"ha": "center", "va": "center", "color": "white", "fontweight": "bold"}
    offset = {"xytext": (0, -0.3), "textcoords": "offset points", "zorder": 11.5}
    axes.annotate(number, xy_m, fontsize=size, **style, **offset)


_TARGET_RANK, _OTHER_RANK, _REJECTED_RANK = 0, 1, 2  # first part of `_rank`


def _rank(record: RunRecord, instance: Instance) -> tuple[int, bool, float]:
    """Return the sort key for labels: targets first, then reached ones, then the highest score."""
    order = _TARGET_RANK if record.is_target(instance.label) else _OTHER_RANK
    if instance.state == "rejected":
        order = _REJECTED_RANK
    return order, instance.state != "reached", -instance.score


def _label(
    axes: Axes,
    words: str,
    xy_m: tuple[float, float],
    colour: str,
    taken: list[raster.Box],
    prominent: bool,
) -> None:
    """Draw a label next to a point, inside the map and not over an earlier label.

    It takes the first of several positions that fits. If none fits, the label is left out unless it
    is prominent, and then large. `taken` is the space of the labels so far, in points; it is
    extended.
    """
    size = 10.5 if prominent else 8.0
    width, height = 0.57 * size * len(words) + 8, 1.5 * size  # estimated, in points
    to_points = 72.0 / axes.figure.dpi
    x, y = (float(v) * to_points for v in axes.transData.transform(xy_m))
    # Offsets of the label's lower left corner from the point: above and below, right and left.
    offsets = [(dx, dy) for dy in (9, -9 - height, 22, -22 - height) for dx in (7, -7 - width)]
    inside = axes.get_window_extent()
    limits = (inside.x0 * to_points, inside.x1 * to_points)
    for dx, dy in offsets:
        box = (x + dx, x + dx + width, y + dy, y + dy + height)
        fits = box[0] >= limits[0] and box[1] <= limits[1]
        if fits and not any(_overlap(box, other) for other in taken):
            break
    else:
        if not prominent:
            return
        dx, dy = offsets[0]
    taken.append((x + dx, x + dx + width, y + dy, y + dy + height))
    axes.annotate(
        plain(words),
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


def plain(text: str) -> str:
    """Escape text that matplotlib would read as mathematics."""
    return text.replace("$", r"\$")


def poses(axes: Axes, record: RunRecord) -> None:
    """Draw the robot at the start (outlined) and at the end (filled) as arrow heads."""
    if not len(record.trajectory):
        return
    end_colour = palette.outcome_colour(record.mission.phase)
    for index, face, edge in ((0, "white", palette.START), (-1, end_colour, "white")):
        x_m, y_m, yaw_rad = record.trajectory[index]
        marker = dart(yaw_rad)
        axes.scatter(x_m, y_m, s=420, marker=marker, color=face, edgecolor=edge, lw=1.8, zorder=10)


def dart(yaw_rad: float) -> MarkerStyle:
    """Return a marker that points along `yaw_rad`."""
    from matplotlib.markers import MarkerStyle
    from matplotlib.path import Path as Outline

    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    outline = np.array([(1.0, 0.0), (-0.75, 0.7), (-0.35, 0.0), (-0.75, -0.7), (1.0, 0.0)])
    return MarkerStyle(Outline(outline @ np.array([(c, s), (-s, c)]), closed=True))
