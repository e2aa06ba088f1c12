"""A picture as a list of shapes, and the two ways to write it: SVG and PNG.

Lengths are in px of the SVG; y goes downwards. Text is plain text, escaped where it is written.
"""

from __future__ import annotations

import io
import unicodedata
from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING, Literal, NamedTuple, Union

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER = "#ffffff"
PNG_SCALE = 2.0
Points = Sequence[tuple[float, float]]


class Curve(NamedTuple):
    """A line of cubic Bezier curves: 1 + 3 n points."""

    points: Points
    colour: str
    width: float = 1.0


class Polygon(NamedTuple):
    points: Points
    fill: str


class Disc(NamedTuple):
    x: float
    y: float
    radius: float
    fill: str
    outline: str
    width: float = 1.4
    dashed: bool = False


class Box(NamedTuple):
    x: float
    y: float
    width: float
    height: float
    fill: str
    radius: float = 3.0


class Text(NamedTuple):
    """One line; `y` is its baseline."""

    text: str
    x: float
    y: float
    size: float
    colour: str
    anchor: Literal["start", "middle", "end"] = "start"
    bold: bool = False


Shape = Union[Curve, Polygon, Disc, Box, Text]


class Group(NamedTuple):
    """Shapes that share a tooltip."""

    title: str
    shapes: tuple[Shape, ...]


class Picture(NamedTuple):
    title: str
    width: float
    height: float
    parts: tuple[Group, ...]


def text_width(text: str, size: float) -> float:
    """About how wide text is in a sans-serif face, on the wide side."""
    ems = sum(1.0 if unicodedata.east_asian_width(c) in "WF" else 0.6 for c in text)
    return ems * size


def shorten(text: str, length: int) -> str:
    """Printable text of at most `length` characters."""
    text = "".join(c if c.isprintable() else "�" for c in text)
    return text if len(text) <= length else f"{text[: length - 1]}…"


def paragraph(text: str, size: float, width: float) -> tuple[str, ...]:
    """Text broken at spaces into lines of about `width`."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and text_width(longer, size) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return tuple(lines)


# -- SVG --------------------------------------------------------------------------------------


def svg(picture: Picture) -> str:
    """One `<svg>` element: no script, no ids, nothing fetched, as wide as its place allows."""
    w, h = f"{picture.width:.0f}", f"{picture.height:.0f}"
    return "".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w} {h}" '
            f'style="display:block;width:100%;max-width:{w}px;height:auto;border-radius:8px" '
            f'font-family="sans-serif" role="img"><title>{escape(picture.title)}</title>',
            f'<rect width="{w}" height="{h}" fill="{PAPER}"/>',
            *_svg_groups(picture.parts),
            "</svg>",
        )
    )


def _svg_groups(parts: Sequence[Group]) -> Iterator[str]:
    for title, shapes in parts:
        yield f"<g><title>{escape(title)}</title>" if title else "<g>"
        yield from map(_svg_shape, shapes)
        yield "</g>"


def _svg_shape(shape: Shape) -> str:
    if isinstance(shape, Curve):
        (x, y), *rest = shape.points
        bends = " ".join(f"{x:.1f} {y:.1f}" for x, y in rest)
        return (
            f'<path d="M{x:.1f} {y:.1f}C{bends}" fill="none" stroke="{shape.colour}" '
            f'stroke-width="{shape.width:g}"/>'
        )
    if isinstance(shape, Polygon):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in shape.points)
        return f'<polygon points="{points}" fill="{shape.fill}"/>'
    if isinstance(shape, Disc):
        dash = ' stroke-dasharray="3 2"' if shape.dashed else ""
        return (
            f'<circle cx="{shape.x:.1f}" cy="{shape.y:.1f}" r="{shape.radius:g}" '
            f'fill="{shape.fill}" stroke="{shape.outline}" stroke-width="{shape.width:g}"{dash}/>'
        )
    if isinstance(shape, Box):
        return (
            f'<rect x="{shape.x:.1f}" y="{shape.y:.1f}" width="{shape.width:.1f}" '
            f'height="{shape.height:.1f}" rx="{shape.radius:g}" fill="{shape.fill}"/>'
        )
    anchor = "" if shape.anchor == "start" else f' text-anchor="{shape.anchor}"'
    bold = ' font-weight="700"' if shape.bold else ""
    return (
        f'<text x="{shape.x:.1f}" y="{shape.y:.1f}" font-size="{shape.size:g}" '
        f'fill="{shape.colour}"{anchor}{bold}>{escape(shape.text)}</text>'
    )


# -- PNG --------------------------------------------------------------------------------------


def png(picture: Picture) -> bytes:
    """The same picture as a PNG file's content, `PNG_SCALE` pixels to a px."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # 72 px an inch: one unit of the axes is a point, in which matplotlib gives sizes of text.
    size = (picture.width / 72, picture.height / 72)
    figure = Figure(figsize=size, dpi=72 * PNG_SCALE, facecolor=PAPER)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, picture.width), ylim=(picture.height, 0))
    axes.axis("off")
    for order, shape in enumerate(shape for group in picture.parts for shape in group.shapes):
        _png_shape(axes, shape, order)
    out = io.BytesIO()
    canvas.print_png(out)
    return out.getvalue()


def _png_shape(axes: Axes, shape: Shape, order: int) -> None:
    from matplotlib import patches
    from matplotlib.path import Path

    if isinstance(shape, Text):
        axes.text(
            shape.x,
            shape.y,
            shape.text,
            fontsize=shape.size * 0.92,  # matplotlib's own face is wide
            color=shape.colour,
            fontweight="bold" if shape.bold else "normal",
            ha={"start": "left", "middle": "center", "end": "right"}[shape.anchor],
            va="baseline",
            parse_math=False,
            zorder=order,
        )
    elif isinstance(shape, Curve):
        codes = [Path.MOVETO] + [Path.CURVE4] * (len(shape.points) - 1)
        style = {"edgecolor": shape.colour, "facecolor": "none", "lw": shape.width}
        axes.add_patch(patches.PathPatch(Path(shape.points, codes), **style, zorder=order))
    elif isinstance(shape, Polygon):
        axes.add_patch(patches.Polygon(shape.points, facecolor=shape.fill, lw=0, zorder=order))
    elif isinstance(shape, Disc):
        style = {"facecolor": shape.fill, "edgecolor": shape.outline, "lw": shape.width}
        dash = "--" if shape.dashed else "-"
        at = (shape.x, shape.y)
        axes.add_patch(patches.Circle(at, shape.radius, ls=dash, **style, zorder=order))
    else:
        at, r = (shape.x + shape.radius, shape.y + shape.radius), shape.radius
        w, h = max(0.0, shape.width - 2 * r), max(0.0, shape.height - 2 * r)
        rounded = f"round,pad={r},rounding_size={r}"
        style = {"facecolor": shape.fill, "lw": 0, "boxstyle": rounded, "mutation_aspect": 1}
        axes.add_patch(patches.FancyBboxPatch(at, w, h, **style, zorder=order))
