"""Drawing areas of matplotlib for reports and evaluations, and their content as SVG and PNG.

A page is a drawing in pixels; plots have axes with scales. matplotlib is imported inside the
functions, because the import is slow.
"""

from __future__ import annotations

import io
import unicodedata
import warnings
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

from edge.host.files import save
from edge.lab.report import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER = "#ffffff"  # colour of the background
PNG_SCALE = 2.0  # pixels of a PNG for each px of a page
_MAX_ALT = 4000  # characters of a drawing's alternative text


class LineStyle(NamedTuple):
    """Look of a line: colour, marker and dash pattern, in matplotlib's notation.

    The colours are those of Okabe and Ito, which colour-blind readers can distinguish, and four
    more. Marker and dash pattern distinguish lines without colour.
    """

    colour: str
    mark: str
    dash: str | tuple


_COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a8a8a",
    "#882255", "#5d3a9b", "#7f4f1c", "#a6b51e",
)  # fmt: skip
_MARKS = "osD^vP*X"
_DASHES: tuple[str | tuple, ...] = ("-", (0, (5, 1.6)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)))


def style_of(index: int) -> LineStyle:
    """Return the look of a line by its index; after twelve, the colours repeat."""
    k, turn = index % len(_COLOURS), index // len(_COLOURS)
    return LineStyle(
        _COLOURS[k], _MARKS[(k + turn) % len(_MARKS)], _DASHES[(k + turn) % len(_DASHES)]
    )


def page(width_px: float, height_px: float) -> Axes:
    """Return empty axes that fill a figure: x to the right, y downwards, in px of the SVG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # 72 px an inch: one unit of the axes is a point, in which matplotlib gives sizes.
    figure = Figure(figsize=(width_px / 72, height_px / 72), dpi=72, facecolor=PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width_px), ylim=(height_px, 0))
    axes.axis("off")
    return axes


def plots(
    size_in: tuple[float, float], columns: int = 1, rows: int = 1, dpi: int = 150
) -> tuple[Figure, list[Axes]]:
    """Return a figure with empty axes for plots, row by row, with a grid and no frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(size_in, dpi, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    all_axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in all_axes:
        axes.grid(color=palette.UNKNOWN, linewidth=0.7)
        axes.set_axisbelow(True)
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set_color(palette.INFLATED)
        axes.tick_params(colors=palette.MUTED, labelsize=9)
        for axis in (axes.xaxis, axes.yaxis):
            axis.label.set_color(palette.INK)
    return figure, all_axes


def write(axes: Axes, text: str, x: float, y: float, size: float, **style: Any) -> None:
    """Write plain text, vertically centred at `y`."""
    axes.text(x, y, text, fontsize=size, va="center_baseline", parse_math=False, **style)


def text_width(text: str, size: float) -> float:
    """Return the approximate width of text in a sans-serif font; it errs on the wide side."""
    ems = sum(1.0 if unicodedata.east_asian_width(c) in "WF" else 0.6 for c in text)
    return ems * size


def content(figure: Figure, kind: str, **options: Any) -> bytes:
    """Return a figure as the content of an "svg" or "png" file, repeatably."""
    from matplotlib import rc_context

    out = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else None
    # Text stays text: a browser has more characters than matplotlib's font.
    with rc_context({"svg.hashsalt": "edge", "svg.fonttype": "none"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(out, format=kind, metadata=metadata, **options)
    return out.getvalue()


def save_plots(
    figures: Mapping[str, Figure], folder: Path, kinds: Sequence[str] = ("svg", "png")
) -> list[Path]:
    """Write figures by name as files of each kind, and return the files."""
    paths = []
    for kind in kinds:
        for name, figure in figures.items():
            paths.append(folder / f"{name}.{kind}")
            save(paths[-1], content(figure, kind))
    return paths


def svg(axes: Axes) -> bytes:
    """Return a page as the content of an SVG file."""
    return content(axes.figure, "svg")


def png(axes: Axes) -> bytes:
    """Return a page as the content of a PNG file, with `PNG_SCALE` pixels for each px."""
    return content(axes.figure, "png", dpi=72 * PNG_SCALE)


def img(axes: Axes, alternative: str) -> str:
    """Return a page as an `<img>` with its SVG inside; it runs no script and fetches nothing."""
    width_px = 72 * axes.figure.get_figwidth()
    source = quote(svg(axes).decode("utf-8"), safe=" /:=(),;'")
    return (
        f'<img style="display:block;width:100%;max-width:{width_px:.0f}px;height:auto" '
        f'alt="{escape(alternative[:_MAX_ALT])}" src="data:image/svg+xml,{source}">'
    )
