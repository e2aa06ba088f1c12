"""A mission over time: which target was pursued when, and what became of it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from edge.report import palette
from edge.report.drawing.shapes import (
    Box,
    Curve,
    Disc,
    Group,
    Picture,
    Polygon,
    Shape,
    Text,
    shorten,
)
from edge.report.record import RunRecord
from edge.types import Step

WIDTH = 1100.0
LEFT, RIGHT, TOP, ROW, FOOT = 170.0, 24.0, 14.0, 28.0, 62.0
BAR = 14.0
TEXT = 12.0
MAX_ROWS = 40
LINE, ZEBRA = "#dde2ea", "#f6f8fb"
MARKED = ("seen", "reached", "failed", "warning")
TICKS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 18000, 36000)


class Span(NamedTuple):
    """A time in which one target was pursued; `settled` when it was reached or failed then."""

    label: str
    start_s: float
    end_s: float
    settled: bool
    reason: str


def spans(record: RunRecord) -> list[Span]:
    """The targets that were pursued, in order of time."""
    done: list[Span] = []
    pursued: Step | None = None
    settled = False
    for step in _steps(record):
        if step.kind in ("target", "end"):
            done += _span(record, pursued, record.seconds(step.stamp_ns), settled)
            pursued, settled = (step if step.kind == "target" else None), False
        elif pursued is not None and step.label == pursued.label:
            settled |= step.kind in ("reached", "failed")
    return done + _span(record, pursued, _last_s(record), True)


def _steps(record: RunRecord) -> tuple[Step, ...]:
    return record.story.steps if record.story is not None else ()


def _span(record: RunRecord, step: Step | None, end_s: float, settled: bool) -> list[Span]:
    if step is None:
        return []
    start_s = record.seconds(step.stamp_ns)
    return [Span(step.label, start_s, max(start_s, end_s), settled, step.text)]


def _last_s(record: RunRecord) -> float:
    """When the newest thing that the record knows of happened."""
    times = [t_s for t_s, _ in record.events[-1:]]
    times += record.trajectory_t_s[-1:].tolist()
    times += [record.seconds(step.stamp_ns) for step in _steps(record)[-1:]]
    return max(times, default=0.0)


def picture(record: RunRecord) -> Picture | None:
    """Bars for what was pursued, marks for what happened; None when there is nothing to show."""
    steps = _steps(record)
    labels = list(dict.fromkeys(s.label for s in steps if s.label))
    if not labels:
        return None
    rows = {label: k for k, label in enumerate(labels[:MAX_ROWS])}
    begin_s = min(0.0, record.seconds(steps[0].stamp_ns))
    chart = _Chart(record, rows, begin_s, max(_last_s(record), begin_s + 1.0))
    parts = (*chart.grid(), *chart.bars(), *chart.end(), *chart.marks(), *chart.legend(len(labels)))
    return Picture("The mission over time", WIDTH, TOP + ROW * len(rows) + FOOT, parts)


class _Chart(NamedTuple):
    record: RunRecord
    rows: dict[str, int]
    begin_s: float
    end_s: float

    def x(self, t_s: float) -> float:
        part = (t_s - self.begin_s) / (self.end_s - self.begin_s)
        return LEFT + min(1.0, max(0.0, part)) * (WIDTH - LEFT - RIGHT)

    def y(self, label: str) -> float:
        return TOP + ROW * (self.rows[label] + 0.5)

    def colour(self, label: str) -> str:
        return palette.target_colour(label, self.record.targets)

    @property
    def bottom(self) -> float:
        return TOP + ROW * len(self.rows)

    def grid(self) -> Iterator[Group]:
        for label, k in self.rows.items():
            ground = Box(0, TOP + k * ROW, WIDTH, ROW, ZEBRA if k % 2 == 0 else "#ffffff", 0)
            words = Text(
                shorten(label, 22),
                LEFT - 12,
                self.y(label) + 4,
                TEXT,
                self.colour(label),
                "end",
                True,
            )
            yield Group(shorten(label, 200), (ground, words))
        span_s = self.end_s - self.begin_s
        step_s = next((t for t in TICKS_S if span_s / t <= 12), TICKS_S[-1] * 10)
        ticks = [k * step_s for k in range(int(span_s / step_s) + 1)]
        lines = [(_line(self.x(t), TOP, self.bottom, LINE), _tick(self, t)) for t in ticks]
        yield Group("", tuple(shape for pair in lines for shape in pair))

    def bars(self) -> Iterator[Group]:
        """A switch before the target was reached is a line from the end of a bar to the next."""
        pursued = [span for span in spans(self.record) if span.label in self.rows]
        for span in pursued:
            x0, x1 = self.x(span.start_s), self.x(span.end_s)
            y = self.y(span.label) - BAR / 2
            bar = Box(x0, y, max(2.0, x1 - x0), BAR, self.colour(span.label))
            title = f"{span.start_s:.1f} to {span.end_s:.1f} s: {shorten(span.reason, 300)}"
            yield Group(title, (bar,))
        for before, after in pairwise(pursued):
            if not before.settled:
                title = f"switched at {after.start_s:.1f} s: {shorten(after.reason, 300)}"
                yield Group(
                    title, _switch(self.x(after.start_s), self.y(before.label), self.y(after.label))
                )

    def end(self) -> Iterator[Group]:
        for step in self.record.story.steps:
            if step.kind == "end":
                colour = palette.outcome_colour(self.record.mission.phase)
                x = self.x(self.record.seconds(step.stamp_ns))
                yield Group(shorten(step.text, 300), (_line(x, TOP, self.bottom, colour, 2.0),))

    def marks(self) -> Iterator[Group]:
        steps = [s for s in self.record.story.steps if s.kind in MARKED and s.label in self.rows]
        order = [s for s in self.record.story.steps if s.kind == "reached"]
        for step in sorted(steps, key=lambda step: step.kind in ("reached", "failed")):
            t_s = self.record.seconds(step.stamp_ns)
            number = next((f"{k}" for k, s in enumerate(order, start=1) if s is step), "")
            mark = _mark(step.kind, self.x(t_s), self.y(step.label), number)
            yield Group(f"{t_s:.1f} s: {shorten(step.text, 300)}", mark)

    def legend(self, n_labels: int) -> Iterator[Group]:
        x, y = LEFT, self.bottom + FOOT - 16
        for kind, words in (("seen", "seen"), ("reached", "reached, in this order"),
                            ("failed", "failed"), ("warning", "warning")):  # fmt: skip
            text = Text(words, x + 13, y + 4, 11, palette.MUTED)
            yield Group("", (*_mark(kind, x, y, "1"), text))
            x += 42 + 6.6 * len(words)
        switch = Text("switched to another before that", x + 13, y + 4, 11, palette.MUTED)
        yield Group("", (*_switch(x, y - 8, y + 8), switch))
        if n_labels > len(self.rows):
            more = f"{n_labels - len(self.rows)} more targets are not shown"
            yield Group("", (Text(more, WIDTH - RIGHT, y + 4, 11, palette.MUTED, "end"),))


def _line(x: float, y0: float, y1: float, colour: str, width: float = 1.0) -> Curve:
    return Curve(((x, y0), (x, y0), (x, y1), (x, y1)), colour, width)


def _tick(chart: _Chart, t_s: float) -> Text:
    words = f"{t_s:g} s" if t_s < 300 else f"{t_s / 60:g} min"
    return Text(words, chart.x(t_s), chart.bottom + 16, 11, palette.MUTED, "middle")


def _switch(x: float, y0: float, y1: float) -> tuple[Shape, ...]:
    down = 1.0 if y1 > y0 else -1.0
    tip = y1 - down * (BAR / 2 if abs(y1 - y0) > ROW / 2 + 3 else 0.0)
    head = ((x, tip), (x - 4, tip - 6 * down), (x + 4, tip - 6 * down))
    return (_line(x, y0, tip - 5 * down, palette.INK, 1.4), Polygon(head, palette.INK))


def _mark(kind: str, x: float, y: float, number: str) -> tuple[Shape, ...]:
    if kind == "seen":
        return (Disc(x, y, 4.5, "#ffffff", palette.INK, 1.6),)
    if kind == "warning":
        triangle = ((x, y - 8), (x - 7.5, y + 5.5), (x + 7.5, y + 5.5))
        return Polygon(triangle, palette.WARNING), Text("!", x, y + 4.5, 10, "#fff", "middle", True)
    colour = palette.OUTCOME[kind]
    words = number if kind == "reached" else "×"
    disc = Disc(x, y, 9.0, colour, "#ffffff", 1.5)
    return disc, Text(words, x, y + 4, 11, "#ffffff", "middle", True)
