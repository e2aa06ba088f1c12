"""The picture of an automaton: a scene, laid out, as shapes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from edge.report.drawing.layout import Layout, Link, Route, Size, layered
from edge.report.drawing.scene import Arrow, Node, Role, Scene
from edge.report.drawing.shapes import (
    PAPER,
    Box,
    Curve,
    Disc,
    Group,
    Picture,
    Polygon,
    Text,
    paragraph,
    text_width,
)

RADIUS = 15.0
MARGIN = 14.0
ENTRY = 26.0  # length of the arrow that comes from nowhere to the initial state
LABEL, CAPTION, NOTE = 12.0, 10.0, 11.0
LEADING = 1.2
MIN_WIDTH = 430.0
PORT_RAD = math.radians(42)  # how far from level the outermost arrows touch a state

INK, MUTED, FORBIDDEN = "#1c2430", "#66707f", "#a61e4d"
CURRENT, DEAD, STATE = "#1864ab", "#e3e6eb", "#f4f6f9"


class Style(NamedTuple):
    """Of an arrow: `pull` is how much it wants to be level, `order` what it covers."""

    colour: str
    width: float
    ink: str
    pull: float
    order: int


STYLES: dict[Role, Style] = {
    "other": Style("#9aa4b2", 1.1, INK, 1.0, 0),
    "visited": Style("#2b8a3e", 2.4, "#2b8a3e", 6.0, 1),
    "plan": Style("#1c7ed6", 2.4, "#1864ab", 6.0, 2),
}


def picture(scene: Scene, title: str) -> Picture:
    """Arrows first, then labels on a ground of their own, then states, then the note."""
    links = [Link(a.source, a.target, _label_size(a), STYLES[a.role].pull) for a in scene.arrows]
    layout = layered([_node_size(node) for node in scene.nodes], links)
    needed = layout.width + 2 * MARGIN + ENTRY
    width = max(MIN_WIDTH, needed)
    layout = _moved(layout, MARGIN + ENTRY + (width - needed) / 2, MARGIN)
    note = paragraph(scene.note, NOTE, width - 2 * MARGIN)
    top = layout.height + 2 * MARGIN + NOTE
    parts = (
        *_arrows(scene, layout),
        *(_label(arrow, route) for arrow, route in zip(scene.arrows, layout.routes, strict=True)),
        *(_node(node, *at) for node, at in zip(scene.nodes, layout.centres, strict=True)),
        Group("", tuple(
            Text(line, MARGIN, top + k * NOTE * LEADING, NOTE, MUTED)
            for k, line in enumerate(note)
        )),
    )  # fmt: skip
    return Picture(title, width, top + (len(note) - 1) * NOTE * LEADING + MARGIN, parts)


def _node_size(node: Node) -> Size:
    caption = max((text_width(line, CAPTION) for line in node.forbidden), default=0.0)
    below = len(_captions(node)) * CAPTION * LEADING
    return Size(max(caption, 2 * RADIUS), 2 * RADIUS + 4.0, below + 3.0 if below else 0.0)


def _captions(node: Node) -> list[tuple[str, str]]:
    """Lines under a state, with their colours."""
    lines = [(line, FORBIDDEN) for line in node.forbidden]
    return [*lines, (f"+ {node.hidden}", MUTED)] if node.hidden else lines


def _label_size(arrow: Arrow) -> Size:
    bold = 1.0 if arrow.role == "other" else 1.08
    width = max(text_width(line, LABEL * bold) for line in arrow.lines)
    return Size(width + 6.0, len(arrow.lines) * LABEL * LEADING + 2.0)


def _moved(layout: Layout, x: float, y: float) -> Layout:
    def move(points: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
        return tuple((px + x, py + y) for px, py in points)

    routes = tuple(Route(move(points), move([label])[0]) for points, label in layout.routes)
    return layout._replace(centres=move(layout.centres), routes=routes)


def _arrows(scene: Scene, layout: Layout) -> Iterator[Group]:
    for node, (x, y) in zip(scene.nodes, layout.centres, strict=True):
        if node.initial:
            tip = (x - RADIUS, y)
            line = ((x - RADIUS - ENTRY, y), (x - RADIUS - ENTRY, y), tip, tip)
            yield _arrow(line, STYLES["other"], "the mission begins here")
    ends = _ports(scene, layout)
    for k in sorted(range(len(ends)), key=lambda k: STYLES[scene.arrows[k].role].order):
        curve = _curve(layout.routes[k], *ends[k])
        yield _arrow(curve, STYLES[scene.arrows[k].role], scene.arrows[k].title)


def _arrow(points: Sequence[tuple[float, float]], style: Style, title: str) -> Group:
    """A curve, which is level at its end, and its head."""
    x, y = points[-1]
    size = 5.5 + style.width
    before = next((px for px, _ in reversed(points) if px != x), x - 1)
    back = -size if before < x else size
    head = ((x, y), (x + back, y - 0.45 * size), (x + back, y + 0.45 * size))
    stop = (x + 0.7 * back, y)  # a wide line would show around the tip
    line = (*points[:-2], stop, stop)
    return Group(title, (Curve(line, style.colour, style.width), Polygon(head, style.colour)))


def _ports(scene: Scene, layout: Layout) -> list[list[tuple[float, float]]]:
    """For each arrow where it leaves its source's rim, and where it meets its target's.

    Arrows on the same side of a state fan out in the order of what they lead to.
    """
    sides: dict[tuple[int, bool], list[tuple[float, int, int]]] = {}
    for k, (arrow, route) in enumerate(zip(scene.arrows, layout.routes, strict=True)):
        right = route.points[0][0] < route.points[-1][0]
        sides.setdefault((arrow.source, right), []).append((route.points[1][1], k, 0))
        sides.setdefault((arrow.target, not right), []).append((route.points[-2][1], k, 1))
    ends = [[(0.0, 0.0), (0.0, 0.0)] for _ in scene.arrows]
    for (node, right), those in sides.items():
        spread = PORT_RAD * min(1.0, (len(those) - 1) / 3)
        x, y = layout.centres[node]
        for i, (_, k, end) in enumerate(sorted(those)):
            angle = spread * (2 * i / (len(those) - 1) - 1) if len(those) > 1 else 0.0
            across = math.cos(angle) * RADIUS * (1 if right else -1)
            ends[k][end] = (x + across, y + math.sin(angle) * RADIUS)
    return ends


def _curve(
    route: Route, start: tuple[float, float], end: tuple[float, float]
) -> list[tuple[float, float]]:
    """Level at every point of the route; bends lie between columns only."""
    first, last = (route.points[0][0], start[1]), (route.points[-1][0], end[1])
    stops = [start, first, *route.points[1:-1], last, end]
    curve = [start]
    for (x0, y0), (x1, y1) in pairwise(stops):
        curve += [((x0 + x1) / 2, y0), ((x0 + x1) / 2, y1), (x1, y1)]
    return curve


def _label(arrow: Arrow, route: Route) -> Group:
    (x, y), (w, h, _), style = route.label, _label_size(arrow), STYLES[arrow.role]
    first = y + 0.35 * LABEL - (len(arrow.lines) - 1) * LABEL * LEADING / 2
    lines = tuple(
        Text(
            line, x, first + k * LABEL * LEADING, LABEL, style.ink, "middle", arrow.role != "other"
        )
        for k, line in enumerate(arrow.lines)
    )
    return Group(arrow.title, (Box(x - w / 2, y - h / 2, w, h, PAPER), *lines))


def _node(node: Node, x: float, y: float) -> Group:
    fill, edge, ink = STATE, INK, INK
    if node.dead:
        fill, edge, ink = DEAD, MUTED, MUTED
    if node.current:
        fill, edge, ink = CURRENT, CURRENT, PAPER
    shapes = [Disc(x, y, RADIUS, fill, edge, dashed=node.dead)]
    if node.accepting:
        shapes.append(Disc(x, y, RADIUS - 3.5, "none", PAPER if node.current else edge))
    number = f"{node.state}"
    size = min(LABEL, (1.55 if node.accepting else 1.9) * RADIUS / text_width(number, 1.0))
    texts = [Text(number, x, y + 0.35 * size, size, ink, "middle", node.current)]
    for k, (line, colour) in enumerate(_captions(node), start=1):
        texts.append(Text(line, x, y + RADIUS + k * CAPTION * LEADING, CAPTION, colour, "middle"))
    return Group(node.title, (*shapes, *texts))
