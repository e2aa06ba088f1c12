"""Drawing of a mission's automaton with matplotlib, laid out in columns.

States stand in even columns, ordered by their distance from the start. The labels of arrows stand
in odd columns, so no label covers a state or another label. A scene is the `AutomatonGraph` to
draw; its nodes are the states.
"""

from __future__ import annotations

import math
import textwrap
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, NamedTuple, Union

from edge.lab.report import canvas
from edge.lab.report.canvas import PAPER, text_width
from edge.lab.report.palette import INK, MUTED
from edge.live.automaton_graph import AutomatonGraph, Role, StateArrow, StateNode

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Lengths and font sizes in px.
RADIUS = 15.0  # of a state
MARGIN = 14.0  # around the page
ENTRY = 26.0  # length of the entry arrow into the initial state
LABEL = 11.0  # font size of the labels on arrows
CAPTION = 9.2  # font size of the lines under states
NOTE = 10.0  # font size of the note under the graph
LEADING = 1.25  # height of a line, in font sizes
MIN_WIDTH = 430.0  # of the page
GAP = 40.0  # space next to a label, where arrows bend
FAN = 0.3  # steepness with which arrows spread from a state
# Colours: forbidden propositions, current state, state without a way to success, other states.
FORBIDDEN, CURRENT, DEAD, STATE = "#a61e4d", "#1864ab", "#e3e6eb", "#f4f6f9"


class ArrowStyle(NamedTuple):
    """Look of an arrow.

    Attributes:
        ink: colour of the label.
        order: arrows with a higher one are on top.
    """

    colour: str
    width: float
    ink: str
    order: int


STYLES: dict[Role, ArrowStyle] = {
    "other": ArrowStyle("#9aa4b2", 1.1, INK, 0),
    "visited": ArrowStyle("#2b8a3e", 2.4, "#2b8a3e", 1),
    "plan": ArrowStyle("#1c7ed6", 2.4, "#1864ab", 2),
}


ColumnItem = Union[int, tuple[int, int]]
"""Item of a column: a state by its index in the scene, or the part of an arrow in this column, as
(index of the arrow, column)."""


class GraphLayout(NamedTuple):
    """Positions in px, y downwards.

    Attributes:
        nodes: (x, y) of each node.
        routes: points (x, y) that each arrow passes between its states; its label is at the first.
        half: half the width of the widest label.
    """

    width: float
    height: float
    nodes: list[tuple[float, float]]
    routes: list[list[tuple[float, float]]]
    half: float


def draw(scene: AutomatonGraph) -> Axes:
    """Draw a scene: arrows, labels on their own background, states, and the note.

    Green: the way to the current state. Blue: the plan from there. Filled: the current state.
    Double ring: an accepting state.
    """
    layout = lay_out(scene)
    width = max(MIN_WIDTH, layout.width)
    note = textwrap.wrap(scene.note, int((width - 2 * MARGIN) / text_width("x", NOTE)))
    axes = canvas.page(width, layout.height + MARGIN + len(note) * NOTE * LEADING)
    for arrow, route in zip(scene.arrows, layout.routes, strict=True):
        _draw_arrow(axes, arrow, route, layout)
    for node, (x, y) in zip(scene.nodes, layout.nodes, strict=True):
        if node.initial:
            _draw_line(axes, [(x - RADIUS - ENTRY, y), (x - RADIUS, y)], STYLES["other"])
        _draw_node(axes, node, x, y)
    for k, line in enumerate(note):
        at = layout.height + (k + 0.5) * NOTE * LEADING
        canvas.write(axes, line, MARGIN, at, NOTE, color=MUTED)
    return axes


def lay_out(scene: AutomatonGraph) -> GraphLayout:
    """Place states, labels and arrow routes: evenly in each column, near their neighbours."""
    # Number of the column that each item is in.
    column: dict[ColumnItem, int] = {i: 2 * rank for i, rank in _ranks(scene).items()}
    neighbours: dict[ColumnItem, list[ColumnItem]] = defaultdict(list)
    # For each arrow its items: source, one part in each column that it passes, target.
    chains: list[list[ColumnItem]] = []
    for k, arrow in enumerate(scene.arrows):
        first, last = column[arrow.source], column[arrow.target]
        step = 1 if first < last else -1
        # A part takes a place in its column, so that nothing is on the arrow.
        passed = [(k, c) for c in range(first + step, last, step)]
        column.update((item, item[1]) for item in passed)
        chains.append([arrow.source, *passed, arrow.target])
        for a, b in pairwise(chains[-1]):
            neighbours[a].append(b)
            neighbours[b].append(a)
    # Height of a row: a state with the most lines below it, or the label with the most lines.
    captions = [line for node in scene.nodes for line, _ in _captions(node)]
    lines = max((len(_captions(node)) for node in scene.nodes), default=0)
    label_lines = max((len(arrow.lines) for arrow in scene.arrows), default=1)
    row = max(2 * RADIUS + 16.0 + lines * CAPTION * LEADING, label_lines * LABEL * LEADING + 7.0)
    # The items of each column, from top to bottom.
    columns = [[s for s in column if column[s] == c] for c in range(1 + max(column.values()))]
    # Sort each column by the mean height of the neighbours: forwards, backwards, forwards.
    y: dict[ColumnItem, float] = {}
    for sweep in (columns, columns[::-1], columns):
        for items in sweep:
            items.sort(key=lambda item: fmean([y[n] for n in neighbours[item] if n in y] or [0.0]))
            # Rows are spread evenly around y = 0.
            y.update((s, (k - (len(items) - 1) / 2) * row) for k, s in enumerate(items))
    # Bold text is wider.
    widths = [text_width(line, LABEL * 1.08) for arrow in scene.arrows for line in arrow.lines]
    half = max(widths, default=0.0) / 2
    side = max([RADIUS, *(text_width(line, CAPTION) / 2 for line in captions)])
    step, left = half + side + GAP, MARGIN + ENTRY + side  # between columns; x of the first one
    height = max(map(len, columns)) * row + 2 * MARGIN
    place = {s: (left + c * step, y[s] + height / 2 - lines * CAPTION * LEADING / 2)
             for s, c in column.items()}  # fmt: skip
    return GraphLayout(
        left + (len(columns) - 1) * step + side + MARGIN,
        height,
        [place[i] for i in range(len(scene.nodes))],
        [[place[item] for item in chain[1:-1]] for chain in chains],
        half,
    )


def _ranks(scene: AutomatonGraph) -> dict[int, int]:
    """Return the number of arrows on the longest path to each state.

    An arrow back within a cycle counts in the other direction, so that no path is endless.
    """
    import networkx as nx

    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(scene.nodes)))
    graph.add_edges_from((arrow.source, arrow.target) for arrow in scene.arrows)
    # State -> number of the cycle (strongly connected component) that it is in.
    cycle = {i: k for k, c in enumerate(nx.strongly_connected_components(graph)) for i in c}
    # Arrows back to a state with a smaller index: turn them round.
    back = [(a, b) for a, b in graph.edges if cycle[a] == cycle[b] and b < a]
    graph.remove_edges_from(back)
    graph.add_edges_from((b, a) for a, b in back)
    return {i: rank for rank, level in enumerate(nx.topological_generations(graph)) for i in level}


def _draw_arrow(
    axes: Axes, arrow: StateArrow, route: Sequence[tuple[float, float]], layout: GraphLayout
) -> None:
    """Draw an arrow: from its source along both sides of its label, then along its route."""
    style, (x, y) = STYLES[arrow.role], route[0]
    source, target = layout.nodes[arrow.source], layout.nodes[arrow.target]
    direction = 1 if source[0] < target[0] else -1
    stops = [(x - direction * layout.half, y), (x + direction * layout.half, y), *route[1:]]
    ends = _port(source, direction, y), _port(target, -direction, route[-1][1])
    _draw_line(axes, [ends[0], *stops, ends[1]], style)
    weight = "normal" if arrow.role == "other" else "bold"
    ground = {"facecolor": PAPER, "edgecolor": "none", "pad": 1.5}
    for k, line in enumerate(arrow.lines):
        at = y + (k - (len(arrow.lines) - 1) / 2) * LABEL * LEADING
        look = {"color": style.ink, "fontweight": weight, "bbox": ground, "zorder": 4}
        canvas.write(axes, line, x, at, LABEL, ha="center", **look)


def _port(centre: tuple[float, float], side: int, towards_y: float) -> tuple[float, float]:
    """Return the point where an arrow touches a state's rim: higher on the rim if it goes up."""
    offset = max(-0.65 * RADIUS, min(0.65 * RADIUS, FAN * (towards_y - centre[1])))
    return centre[0] + side * math.sqrt(RADIUS**2 - offset**2), centre[1] + offset


def _draw_line(axes: Axes, stops: Sequence[tuple[float, float]], style: ArrowStyle) -> None:
    """Draw a curve through points, horizontal at each of them, with an arrow head at its end."""
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


def _draw_node(axes: Axes, node: StateNode, x: float, y: float) -> None:
    """Draw a state as a disc with its number, and its captions below."""
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


def _captions(node: StateNode) -> list[tuple[str, str]]:
    """Return the lines under a state, each as (text, colour)."""
    lines = [(line, FORBIDDEN) for line in node.forbidden]
    return [*lines, (f"+ {node.hidden}", MUTED)] if node.hidden else lines
