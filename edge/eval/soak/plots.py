"""A soak over time: what was watched, with its faults as bands behind."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.eval.soak.record import Row, of
from edge.report import canvas, palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 150
SIZE_IN = (7.6, 3.0)
_LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a8a8a")
"""Okabe and Ito's colours, which colour-blind readers can tell apart."""

Draw = Callable[["Axes", Sequence[Row], np.ndarray], None]
"""Draws samples at these minutes."""


def _memory(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    for k, who in enumerate(("service", "model")):
        _line(axes, minutes, [_used(s, who, "memory_mb") for s in samples], k, f"{who}, MB")
    axes.set_ylim(bottom=0.0)


def _counts(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    for k, (who, key) in enumerate(
        (who, key) for who in ("service", "model") for key in ("threads", "descriptors")
    ):
        _line(axes, minutes, [_used(s, who, key) for s in samples], k, f"{who}: {key}")
    axes.set_ylim(bottom=0.0)


def _beat(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    named = {"interval_ms": "between ticks", "gap_ms": "between beats", "tick_ms": "a tick"}
    for k, (key, what) in enumerate(named.items()):
        for i, (name, dash) in enumerate((("p50", "-"), ("p99", (0, (1, 1.2))))):
            values = [_at(sample, key, i) for sample in samples]
            _line(axes, minutes, values, k, f"{what}, {name}", dash)
    axes.set_yscale("log")
    axes.set_ylabel("ms")


def _ticks(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    _line(axes, minutes, [_number(s.get("ticks")) for s in samples], 0, "ticks in a second")
    _line(axes, minutes, [float(s["readyz"] == 200) for s in samples], 1, "ready (1) or not (0)")
    axes.set_ylim(bottom=0.0)


def _drops(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    last = next((s["dropped"] for s in reversed(samples) if s.get("dropped")), {})
    most = sorted(last, key=last.__getitem__, reverse=True)[: len(_LINES)]
    for k, reason in enumerate(most):
        values = [_number((s.get("dropped") or {}).get(reason, 0)) for s in samples]
        _line(axes, minutes, values, k, reason)
    axes.set_ylim(bottom=0.0)


def _work(axes: Axes, samples: Sequence[Row], minutes: np.ndarray) -> None:
    named = {
        "goals": "goals", "goals_reached": "reached", "goals_failed": "failed",
        "log_a_minute": "log lines in a minute",
    }  # fmt: skip
    for k, (key, what) in enumerate(named.items()):
        _line(axes, minutes, [_number(s.get(key)) for s in samples], k, what)
    axes.set_ylim(bottom=0.0)


PLOTS: dict[str, Draw] = {
    "Memory, resident and its own": _memory,
    "Threads and descriptors": _counts,
    "The beat, by the second": _beat,
    "Ticks": _ticks,
    "Messages dropped since the start, by reason": _drops,
    "Goals since the start, and the log": _work,
}
"""By title."""


def images(rows: Sequence[Row]) -> dict[str, bytes]:
    """The content of a PNG file for each plot; none where there is no sample."""
    samples = of(rows, "sample")
    if not samples:
        return {}
    minutes = np.array([sample["t_s"] for sample in samples]) / 60.0
    return {
        title: canvas.content(_figure(title, draw, samples, minutes, of(rows, "fault")), "png")
        for title, draw in PLOTS.items()
    }


def _figure(
    title: str, draw: Draw, samples: Sequence[Row], minutes: np.ndarray, faults: Sequence[Row]
) -> Figure:
    figure, (axes,) = canvas.plots(SIZE_IN, DPI)
    for fault in faults:
        begin, end = fault["began_s"], fault["began_s"] + fault["lasted_s"]
        colour = palette.OUTCOME["failed"] if fault["broken"] else palette.UNKNOWN
        axes.axvspan(begin / 60.0, end / 60.0, color=colour, alpha=0.5, linewidth=0, zorder=0)
    draw(axes, samples, minutes)
    axes.set_xlim(0.0, max(float(minutes[-1]), 1e-3))
    axes.set_xlabel("minutes")
    axes.set_title(title, loc="left", color=palette.INK, fontsize=11)
    if axes.lines:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=9,
                    labelcolor=palette.INK)  # fmt: skip
    return figure


def _line(
    axes: Axes, minutes: np.ndarray, values: Sequence[float], k: int, name: str,
    dash: str | tuple = "-",
) -> None:  # fmt: skip
    axes.plot(minutes, values, color=_LINES[k % len(_LINES)], linestyle=dash, linewidth=1.1,
              label=name)  # fmt: skip


def _used(sample: Row, who: str, key: str) -> float:
    return _number((sample[who] or {}).get(key))


def _at(sample: Row, key: str, i: int) -> float:
    values = sample.get(key)
    # A second without ticks has no time of one, which a logarithm would put below all others.
    return float(values[i]) if values and values[i] > 0.0 else math.nan


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
