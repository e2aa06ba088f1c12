"""Maps with trails, as SVG. A trail is the path that the robot drove in an episode.

The page has every floor plan once, and the maps refer to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from edge.lab.eval.comparison.worlds import FloorPlanDrawing, point_along
from edge.lab.eval.outcome import EpisodeOutcome
from edge.lab.report.document import data_url
from edge.text import one_line

UNIT_M = 0.05  # metres per unit of the SVG coordinates
# Colours of a trail from start to end: matplotlib's plasma, without the yellow, too pale on white.
RAMP = (
    "#0d0887", "#3e049c", "#6300a7", "#8606a6", "#a62098", "#c03a83", "#d5546e", "#e76f5a",
    "#f68d45", "#f9a535",
)  # fmt: skip
MAX_REASON = 120  # characters
HEADING_M = 0.45  # length of the line that shows the heading at the start
_GOALS = {"frontier": "f", "instance": "i"}  # CSS class by kind of goal; spins have "l"
_MARGIN_M = 1.0


class TrailBackground(NamedTuple):
    """Background of the trails of a world.

    Attributes:
        key: id of its symbols in the page; "" if there are none.
    """

    key: str
    drawing: FloorPlanDrawing

    def units(self, xy_m: np.ndarray) -> np.ndarray:
        """Return (n, 2) points of `map` in SVG coordinates, int64."""
        points_m = np.asarray(xy_m, np.float64).reshape(-1, 2)
        d = self.drawing
        # y counts downwards in SVG.
        flipped = np.stack([points_m[:, 0] - d.left_m, d.top_m - points_m[:, 1]], axis=1)
        return np.rint(flipped / UNIT_M).astype(np.int64)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in SVG coordinates."""
        d = self.drawing
        return math.ceil(d.width_m / UNIT_M), math.ceil(d.height_m / UNIT_M)


def backgrounds_of(drawings: Mapping[str, FloorPlanDrawing]) -> dict[str, TrailBackground]:
    """Return the background of each world."""
    return {world: TrailBackground(f"w{k}", d) for k, (world, d) in enumerate(drawings.items())}


def empty_background(outcomes: Sequence[EpisodeOutcome]) -> TrailBackground:
    """Return an empty background as large as some trails."""
    points = [xy for o in outcomes for xy in [*o.trail, o.start[:2]]]
    low, high = np.min(points, axis=0) - _MARGIN_M, np.max(points, axis=0) + _MARGIN_M
    (left, bottom), (right, top) = low.tolist(), high.tolist()
    return TrailBackground("", FloorPlanDrawing(b"", left, top, right - left, top - bottom, {}))


def symbols(grounds: Mapping[str, TrailBackground]) -> str:
    """Return the SVG symbols of floor plans and targets, which the maps refer to."""
    inner = []
    for ground in grounds.values():
        (width, height), drawing = ground.size, ground.drawing
        inner.append(
            f'<image id="{ground.key}" width="{width}" height="{height}" '
            f'preserveAspectRatio="none" href="{data_url("png", drawing.png)}"/>'
        )
        for k, footprints in enumerate(drawing.footprints.values()):
            boxes = "".join(f"{_path(ground.units(corners))}z" for corners in footprints)
            inner.append(f'<path id="{ground.key}t{k}" class="thing" d="{boxes}"/>')
    return f'<svg class="hidden" width="0" height="0"><defs>{"".join(inner)}</defs></svg>'


def figure(
    ground: TrailBackground,
    target: str,
    name: str,
    arm: int,
    outcome: EpisodeOutcome | None,
    spl: float,
) -> str:
    """Return the map of one episode with one arm, and its outcome below.

    `target` is "" for a mission, and `outcome` None if the episode was not run. `arm` is the index
    by which the page's script hides the map.
    """
    words = f"<b>{escape(one_line(name, 40))}</b>"
    if outcome is None:
        return (
            f'<figure data-c="{arm}" class="none"><figcaption>{words} not run</figcaption></figure>'
        )
    facts = f"SPL {spl:.2f} · {outcome.path_m:.1f} m · {outcome.elapsed_s:.0f} s"
    reason = f"{outcome.failure}: " if outcome.failure else ""
    reason += one_line(outcome.reason, MAX_REASON)
    width, height = ground.size
    return (
        f'<figure data-c="{arm}" class="{"ok" if outcome.success else "bad"}">'
        f'<svg viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{escape(one_line(f"{name}: {facts}, {reason}"))}">'
        f"{_ground(ground, target)}{_marks_of(ground, outcome)}</svg>"
        f"<figcaption>{words}<br>{facts}<br>{escape(reason)}</figcaption></figure>"
    )


def _ground(ground: TrailBackground, target: str) -> str:
    if not ground.key:
        return ""
    uses = [ground.key]
    if target in ground.drawing.footprints:
        uses.append(f"{ground.key}t{list(ground.drawing.footprints).index(target)}")
    return "".join(f'<use href="#{key}"/>' for key in uses)


def _marks_of(ground: TrailBackground, outcome: EpisodeOutcome) -> str:
    """Return trail, goals, start, end, and the place at which the target was first seen."""
    trail = np.array(outcome.trail or [outcome.start[:2]], np.float64)
    units = ground.units(trail)
    marks = [_trail(units), _goals(ground, outcome.goal_xy)]
    x, y, yaw = outcome.start
    ahead = np.array([[x, y], [x + HEADING_M * math.cos(yaw), y + HEADING_M * math.sin(yaw)]])
    ends = ground.units(ahead)
    marks.append(f'<path class="heading" d="{_path(ends)}"/>{_circle("start", ends[0], 4)}')
    marks.append(_circle("end", units[-1], 4))
    if outcome.first_sight_path_m is not None:
        seen = point_along(trail, outcome.first_sight_path_m)
        marks.append(_circle("seen", ground.units(seen)[0], 5.5))
    return "".join(marks)


def _trail(units: np.ndarray) -> str:
    """Return the trail in pieces, one for each colour; each begins at the end of the last."""
    moved = np.ones(len(units), bool)
    moved[1:] = (np.diff(units, axis=0) != 0).any(axis=1)
    units = units[moved]
    # Indices at which pieces begin and end. A short trail has fewer pieces than RAMP has colours;
    # their colours, `t0` to `t9`, are then spread over it.
    edges = np.unique(np.linspace(0, len(units) - 1, len(RAMP) + 1).astype(int))
    return "".join(
        f'<path class="t t{k * len(RAMP) // max(len(edges) - 1, 1)}" '
        f'd="{_path(units[first : last + 1])}"/>'
        for k, (first, last) in enumerate(pairwise(edges))
    )


def _goals(ground: TrailBackground, goals: Sequence[Sequence]) -> str:
    """Return a dot for each goal: a line of no length with round ends."""
    dots: dict[str, str] = {}
    for x_m, y_m, kind in goals:
        (x, y), mark = ground.units(np.array([[x_m, y_m]]))[0], _GOALS.get(kind, "l")
        dots[mark] = f"{dots.get(mark, '')}M{x} {y}h0"
    return "".join(f'<path class="g {mark}" d="{d}"/>' for mark, d in sorted(dots.items()))


def _circle(kind: str, at: np.ndarray, radius: float) -> str:
    return f'<circle class="{kind}" cx="{at[0]}" cy="{at[1]}" r="{radius:g}"/>'


def _path(units: np.ndarray) -> str:
    """Return a polyline as short SVG text: its start, then relative steps."""
    steps = np.diff(units, axis=0).ravel().tolist()
    # A minus sign also separates two numbers.
    text = "".join(f"{'' if k == 0 or v < 0 else ' '}{v}" for k, v in enumerate(steps))
    return f"M{units[0, 0]} {units[0, 1]}{f'l{text}' if steps else ''}"
