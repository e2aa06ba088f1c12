"""The picture of an automaton: a scene, laid out in columns, drawn by matplotlib.

Every arrow goes from left to right where no cycle is in its way. Labels have columns of their own
between those of the states (Sugiyama, Tagawa and Toda, 1981), so that none lies on a state or on
another label. Graphviz would do it too, but a robot does not have it installed.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from edge.report import canvas
from edge.report.canvas import PAPER, text_width
from edge.report.palette import INK, MUTED
from edge.report.scene import Arrow, Node, Role, Scene

if TYPE_CHECKING:
    import networkx as nx
    from matplotlib.axes import Axes

RADIUS = 15.0
MARGIN = 14.0
ENTRY = 26.0  # length of the arrow that comes from nowhere to the initial state
LABEL, CAPTION, NOTE = 11.0, 9.2, 10.0
LEADING = 1.25
MIN_WIDTH = 430.0
GAP = 22.0  # between columns, where arrows bend
SWEEPS = 24
FAN = 0.3  # how steeply arrows that part at a state leave it
FORBIDDEN, CURRENT, DEAD, STATE = "#a61e4d", "#1864ab", "#e3e6eb", "#f4f6f9"


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


class Slot(NamedTuple):
    """What stands in a column, a state, a label or an arrow that passes: size in px.

    Attributes:
        above, below: room on either side of its centre.
    """

    width: float
    above: float
    below: float


class Layout(NamedTuple):
    """Where things stand, in px, y downwards.

    Attributes:
        spans: (left, right) of each column.
        centres: (x, y) of each node of the scene.
        routes: for each arrow the (column, y) of the slots between its ends, in its direction;
            its label stands in the first of them, of an arrow to the left in the last.
    """

    width: float
    height: float
    spans: list[tuple[float, float]]
    centres: list[tuple[float, float]]
    routes: list[list[tuple[int, float]]]


def draw(scene: Scene) -> Axes:
    """The picture of a scene: arrows, labels on a ground of their own, states, and the note.

    Green: the way there. Blue: the plan from there. Filled: the current state. Two rings: it
    accepts.
    """
    layout = lay_out(scene)
    width = max(MIN_WIDTH, layout.width)
    note = textwrap.wrap(scene.note, int((width - 2 * MARGIN) / text_width("x", NOTE)))
    axes = canvas.page(width, layout.height + MARGIN + len(note) * NOTE * LEADING)
    for arrow, route in zip(scene.arrows, layout.routes, strict=True):
        _draw_arrow(axes, arrow, route, layout)
    for node, (x, y) in zip(scene.nodes, layout.centres, strict=True):
        if node.initial:
            _draw_line(axes, [(x - RADIUS - ENTRY, y), (x - RADIUS, y)], STYLES["other"])
        _draw_node(axes, node, x, y)
    for k, line in enumerate(note):
        at = layout.height + (k + 0.5) * NOTE * LEADING
        canvas.write(axes, line, MARGIN, at, NOTE, color=MUTED)
    return axes


# -- where it stands --------------------------------------------------------------------------


def lay_out(scene: Scene) -> Layout:
    """Places for what a scene shows; nothing in a column covers anything else in it."""
    slots, chains = _slots(scene)
    columns: list[list] = [[] for _ in range(1 + max(slots.nodes[s]["column"] for s in slots))]
    for slot in slots:
        columns[slots.nodes[slot]["column"]].append(slot)
    y = _heights(slots, columns)
    top = min(y[s] - slots.nodes[s]["size"].above for s in slots) - MARGIN
    bottom = max(y[s] + slots.nodes[s]["size"].below for s in slots) + MARGIN
    spans, x = [], MARGIN + ENTRY
    for column in columns:
        width = max(slots.nodes[s]["size"].width for s in column)
        spans.append((x, x + width))
        x += width + GAP
    states = range(len(scene.nodes))
    return Layout(
        x - GAP + MARGIN,
        bottom - top,
        spans,
        [(sum(spans[slots.nodes[s]["column"]]) / 2, y[s] - top) for s in states],
        [[(slots.nodes[s]["column"], y[s] - top) for s in chain[1:-1]] for chain in chains],
    )


def _slots(scene: Scene) -> tuple[nx.Graph, list[list]]:
    """What stands in the columns, joined along the arrows; and each arrow's slots, ends included.

    States are the numbers of the scene's nodes, and stand in even columns.
    """
    import networkx as nx

    column = {node: 2 * rank for node, rank in _ranks(scene).items()}
    slots = nx.Graph()
    for i, node in enumerate(scene.nodes):
        slots.add_node(i, column=column[i], size=_node_size(node))
    chains = []
    for k, arrow in enumerate(scene.arrows):
        first, last = column[arrow.source], column[arrow.target]
        step = 1 if first < last else -1
        chain = [arrow.source, *((k, c) for c in range(first + step, last, step)), arrow.target]
        for slot in chain[1:-1]:
            slots.add_node(slot, column=slot[1], size=Slot(0.0, 2.0, 2.0))
        slots.nodes[chain[1]]["size"] = _label_size(arrow)
        for a, b in pairwise(chain):
            bends = isinstance(a, int) or isinstance(b, int)
            pull = STYLES[arrow.role].pull * (1.0 if bends else 8.0)
            before = slots.edges[a, b]["pull"] if slots.has_edge(a, b) else 0.0
            slots.add_edge(a, b, pull=before + pull)
        chains.append(chain)
    return slots, chains


def _ranks(scene: Scene) -> dict[int, int]:
    """The longest way to each node, arrows back within a cycle turned round."""
    import networkx as nx

    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(scene.nodes)))
    graph.add_edges_from((arrow.source, arrow.target) for arrow in scene.arrows)
    cycle = {i: k for k, c in enumerate(nx.strongly_connected_components(graph)) for i in c}
    back = [(a, b) for a, b in graph.edges if cycle[a] == cycle[b] and b < a]
    graph.remove_edges_from(back)
    graph.add_edges_from((b, a) for a, b in back)
    return {i: rank for rank, level in enumerate(nx.topological_generations(graph)) for i in level}


def _heights(slots: nx.Graph, columns: Sequence[list]) -> dict:
    """The y of each slot: near its neighbours', in an order that has few arrows cross.

    Columns are sorted by where their slots would like to be, to and fro: first by what lies behind
    in the sweep's direction, at last by both sides.
    """
    y = {slot: float(k) for column in columns for k, slot in enumerate(column)}
    for sweep in range(SWEEPS):
        for column in columns if sweep % 2 == 0 else reversed(columns):
            both = 2 * sweep >= SWEEPS
            wanted = {s: _wanted(slots, s, y, both, sweep % 2 == 0) for s in column}
            column.sort(key=wanted.__getitem__)
            _spread(slots, column, wanted, y)
    return y


def _wanted(slots: nx.Graph, slot, y: dict, both: bool, from_left: bool) -> float:  # type: ignore[no-untyped-def]
    """The mean height of a slot's neighbours, in one column or both."""
    own, total, weight = slots.nodes[slot]["column"], 0.0, 0.0
    for near, edge in slots.adj[slot].items():
        if both or (slots.nodes[near]["column"] < own) == from_left:
            total += edge["pull"] * y[near]
            weight += edge["pull"]
    return total / weight if weight else y[slot]


def _spread(slots: nx.Graph, column: list, wanted: dict, y: dict) -> None:
    """Put a column's slots as near to where they want to be as their order and sizes allow.

    With the sizes taken off it is isotonic regression: neighbours in each other's way share their
    mean.
    """
    offsets, blocks, at = [], [], 0.0  # type: ignore[var-annotated]
    for k, slot in enumerate(column):
        if k:
            at += slots.nodes[column[k - 1]]["size"].below + slots.nodes[slot]["size"].above
        offsets.append(at)
        mean, n = wanted[slot] - at, 1
        while blocks and blocks[-1][0] > mean:
            other, others = blocks.pop()
            mean, n = (mean * n + other * others) / (n + others), n + others
        blocks.append((mean, n))
    levels = [mean for mean, n in blocks for _ in range(n)]
    y.update((s, level + at) for s, level, at in zip(column, levels, offsets, strict=True))


def _node_size(node: Node) -> Slot:
    lines = _captions(node)
    width = max((text_width(line, CAPTION) for line, _ in lines), default=0.0)
    below = RADIUS + len(lines) * CAPTION * LEADING + 8.0
    return Slot(max(width, 2 * RADIUS), RADIUS + 8.0, below)


def _label_size(arrow: Arrow) -> Slot:
    width = max(text_width(line, LABEL * 1.08) for line in arrow.lines)
    half = len(arrow.lines) * LABEL * LEADING / 2 + 3.5
    return Slot(width + 6.0, half, half)


# -- what it looks like -----------------------------------------------------------------------


def _draw_arrow(
    axes: Axes, arrow: Arrow, route: Sequence[tuple[int, float]], layout: Layout
) -> None:
    style, to = STYLES[arrow.role], layout.centres[arrow.target]
    start = layout.centres[arrow.source]
    right = 1 if start[0] < to[0] else -1
    stops = [_port(start, right, route[0][1])]
    for column, y in route:
        stops += [(x, y) for x in layout.spans[column][::right]]
    stops.append(_port(to, -right, route[-1][1]))
    _draw_line(axes, stops, style)
    (left, end), y = layout.spans[route[0][0]], route[0][1]
    bold = "normal" if arrow.role == "other" else "bold"
    ground = {"facecolor": PAPER, "edgecolor": "none", "pad": 1.5}
    for k, line in enumerate(arrow.lines):
        at = y + (k - (len(arrow.lines) - 1) / 2) * LABEL * LEADING
        look = {"color": style.ink, "fontweight": bold, "bbox": ground, "zorder": 4}
        canvas.write(axes, line, (left + end) / 2, at, LABEL, ha="center", **look)


def _port(centre: tuple[float, float], side: int, towards_y: float) -> tuple[float, float]:
    """Where an arrow touches a state's rim: the nearer to the top the higher it goes."""
    up = max(-0.65 * RADIUS, min(0.65 * RADIUS, FAN * (towards_y - centre[1])))
    return centre[0] + side * math.sqrt(RADIUS**2 - up**2), centre[1] + up


def _draw_line(axes: Axes, stops: Sequence[tuple[float, float]], style: Style) -> None:
    """A curve through points, level at each of them, with a head at its end."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    curve = [stops[0]]
    for (x0, y0), (x1, y1) in pairwise(stops):
        curve += [((x0 + x1) / 2, y0), ((x0 + x1) / 2, y1), (x1, y1)]
    path = Path(curve, [Path.MOVETO] + [Path.CURVE4] * (len(curve) - 1))
    head = f"-|>,head_length={5.5 + style.width},head_width={2.5 + 0.45 * style.width}"
    axes.add_patch(
        FancyArrowPatch(
            path=path, arrowstyle=head, mutation_scale=1.0, color=style.colour,
            linewidth=style.width, joinstyle="miter", zorder=1 + style.order,
        )
    )  # fmt: skip


def _draw_node(axes: Axes, node: Node, x: float, y: float) -> None:
    from matplotlib.patches import Circle

    fill, rim, ink = STATE, INK, INK
    if node.dead:
        fill, rim, ink = DEAD, MUTED, MUTED
    if node.current:
        fill, rim, ink = CURRENT, CURRENT, PAPER
    dash = "--" if node.dead else "-"
    axes.add_patch(Circle((x, y), RADIUS, fc=fill, ec=rim, lw=1.4, ls=dash, zorder=5))
    if node.accepting:
        inner = PAPER if node.current else rim
        axes.add_patch(Circle((x, y), RADIUS - 3.5, fc="none", ec=inner, lw=1.4, zorder=5))
    number = f"{node.state}"
    size = min(LABEL, (1.55 if node.accepting else 1.9) * RADIUS / text_width(number, 1.0))
    canvas.write(axes, number, x, y, size, ha="center", color=ink, zorder=6)
    for k, (line, colour) in enumerate(_captions(node)):
        at = y + RADIUS + 5.0 + (k + 0.5) * CAPTION * LEADING
        canvas.write(axes, line, x, at, CAPTION, ha="center", color=colour, zorder=6)


def _captions(node: Node) -> list[tuple[str, str]]:
    """Lines under a state, with their colours."""
    lines = [(line, FORBIDDEN) for line in node.forbidden]
    return [*lines, (f"+ {node.hidden}", MUTED)] if node.hidden else lines
