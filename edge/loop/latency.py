"""Latency of the stages: a preallocated ring of spans, with percentiles, budgets and reports.

The service reads the clock (`time.perf_counter_ns`) and passes the values:

    ring.begin_tick(clock())
    observation = source.poll();  ring.mark(INGEST, clock())
    mapper.update(observation);   ring.mark(MAP, clock())
    ring.end_tick(clock())

Background stages (the detector's worker) measure themselves; the loop calls `span` with the result.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from edge.host.calibration import HINT, SpeedCalibration
from edge.loop.histogram import INTERVAL_BOUNDS_S, STAGE_BOUNDS_S, Histogram, Histograms
from edge.loop.stages import STAGES, TICK_BUDGET_MS, TICK_DEADLINE_MS

TICK = "tick"
NOT_RUN = -1  # duration of a stage that did not run in a tick
_NO_LIMIT = np.iinfo(np.int64).max
# The columns of the ring: the stages, then the tick.
_NAMES = (*(stage.name for stage in STAGES), TICK)
_IN_TICK = (*(stage.in_tick for stage in STAGES), True)
_IN_TICK_MASK = np.array(_IN_TICK)
_BACKGROUND = [column for column, in_tick in enumerate(_IN_TICK) if not in_tick]
_NOTHING_RAN = [NOT_RUN] * len(_NAMES)
_MS_PER_NS = 1e-6
_QUANTILES = np.array([0.50, 0.95, 0.99, 1.0])


class Span(NamedTuple):
    """A time span: one stage of one tick, an entire tick, or one run of a background stage.

    Attributes:
        name: Name of the stage, or `tick`.
        begin_ns: Start on the clock of the ring (`time.perf_counter_ns`). Stages of a tick follow
            each other. A background stage counts as ended when the loop received its result.
        in_tick: True if the time is part of a tick.
    """

    name: str
    begin_ns: int
    took_ns: int
    in_tick: bool


@dataclass(frozen=True, slots=True)
class StageLatency:
    """One row of the latency report.

    Attributes:
        name: Name of the stage, or `tick`.
        budget_ms: Budget for p95; None if the stage has none on this computer.
        n: Number of spans in the window of the percentiles. Ticks in which the stage did not run
            are not counted.
        p50_ms: Percentile over the window; 0 if `n` is 0.
        p95_ms: As `p50_ms`.
        p99_ms: As `p50_ms`.
        max_ms: Longest span of the window; 0 if `n` is 0.
        count: Number of spans since the start.
        overruns: Number of these spans over the budget; for the tick, over `TICK_DEADLINE_MS`.
        drops: Number of inputs that the stage dropped, or failed on, since the start.
        in_tick: True if the stage is part of the tick.
    """

    name: str
    budget_ms: float | None
    n: int
    p50_ms: float
    p95_ms: float
    p99_ms: float
    max_ms: float
    count: int
    overruns: int
    drops: int
    in_tick: bool = True

    @property
    def verdict(self) -> str:
        """`ok` or `over`: p95 compared with the budget; `-` without a budget or without spans."""
        if self.n == 0 or self.budget_ms is None:
            return "-"
        return "ok" if self.p95_ms <= self.budget_ms else "over"


@dataclass(frozen=True, slots=True)
class LatencyReport:
    """The latency of every stage, in the order of the stage table, and of the tick.

    Attributes:
        tick: Row of the entire tick.
        calibration: Calibration of this computer, which scales the budgets. None if it was never
            calibrated; then only the tick and the detector have limits, their deadlines.
    """

    stages: tuple[StageLatency, ...]
    tick: StageLatency
    deadline_ms: float = TICK_DEADLINE_MS
    calibration: SpeedCalibration | None = None

    @property
    def computer(self) -> str:
        """Text about the budgets of this computer."""
        if self.calibration is None:
            return f"for a budget of each stage, {HINT}"
        return f"this computer is {self.calibration}; its budgets are scaled by that"

    def stage(self, name: str) -> StageLatency:
        """Return the row of a stage, or of the tick.

        Raises:
            KeyError: There is no such stage.
        """
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)

    @property
    def limit(self) -> str:
        """Name of the limit of p95: `budget`, or `deadline` without a calibration."""
        return "deadline" if self.calibration is None else "budget"

    @property
    def rows(self) -> tuple[StageLatency, ...]:
        return (*self.stages, self.tick)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object that is sent on `edge.bus.topics.LATENCY`; times in ms."""

        def to_json(row: StageLatency) -> dict[str, Any]:
            values = {key: _rounded(getattr(row, key)) for key in _JSON_FIELDS}
            return {**values, "verdict": row.verdict}

        return {
            "tick": to_json(self.tick),
            "deadline_ms": self.deadline_ms,
            "slowdown": None if self.calibration is None else _rounded(self.calibration.slowdown),
            "stages": {row.name: to_json(row) for row in self.stages},
        }

    def table(self) -> str:
        """Return the report as an aligned text table, one line for each stage, the tick last."""
        limit = self.limit
        header = ("stage", "n", "p50", "p95", "p99", "max", limit, "over", "drops", f"p95/{limit}")
        lines = [_line(header)]
        for row in self.rows:
            lines.append(_line(_cells(row)) + ("" if row.budget_ms is None else f" {row.verdict}"))
        lines.insert(-1, "-" * len(lines[0]))
        lines.append(
            f"times in ms; tick deadline {self.deadline_ms:g} ms missed "
            f"{self.tick.overruns} of {self.tick.count}; * runs in parallel to the tick"
        )
        lines.append(self.computer)
        return "\n".join(lines)


_JSON_FIELDS = tuple(field.name for field in fields(StageLatency) if field.name != "name")


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


def _line(cells: tuple[str, ...]) -> str:
    """Return the cells as one line of the table; the last cell is the bar of `_bar`."""
    widths = (12, 8, 9, 9, 9, 9, 10, 7, 7)  # characters, all but the bar
    name, *numbers, bar = cells
    padded = "".join(f"{cell:>{width}}" for cell, width in zip(numbers, widths[1:], strict=True))
    return f"{name:<{widths[0]}}{padded}  {bar:<10}"


def _cells(row: StageLatency) -> tuple[str, ...]:
    """Return the cells of one line of the table."""
    times = (row.p50_ms, row.p95_ms, row.p99_ms, row.max_ms)
    texts = [f"{value:.3f}" if row.n else "-" for value in times]
    name = row.name if row.in_tick else f"{row.name}*"
    limit = ("-", "-") if row.budget_ms is None else (f"{row.budget_ms:.3g}", f"{row.overruns}")
    return (name, f"{row.count}", *texts, *limit, f"{row.drops}", _bar(row))


def _bar(row: StageLatency) -> str:
    """Return p95 as a share of the budget; a full bar that ends in `>` is over the budget."""
    if row.budget_ms is None:
        return ""
    bar = f"{'#' * min(10, round(10 * row.p95_ms / row.budget_ms)):.<10}"
    return bar[:-1] + ">" if row.verdict == "over" else bar


@dataclass(frozen=True, slots=True)
class LatencyHistograms:
    """Histograms of all durations since the start.

    Attributes:
        stages: By stage name.
        interval: Time from the start of a tick to the start of the next.
    """

    stages: dict[str, Histogram]
    tick: Histogram
    interval: Histogram


class LatencyRing:
    """The spans of the last `capacity` ticks, and of as many runs of each background stage.

    One thread runs the ticks and calls `span` for background stages. Other threads may call
    `report` and `histograms`. A tick enters the ring at once, in `end_tick`, so a report never
    sees half a tick.

    Args:
        capacity: Number of ticks to keep.
        calibration: Calibration of this computer, which scales the budgets. Without it, only
            deadlines count, because 1.5 ms on another computer mean nothing.

    Example:
        >>> ring = LatencyRing(capacity=8)
        >>> ring.begin_tick(0)
        >>> ring.mark(0, 2_000_000)  # stage 0 took 2 ms
        >>> ring.end_tick(3_000_000)
        >>> ring.report().stages[0].p50_ms, ring.report().tick.p50_ms
        (2.0, 3.0)
    """

    def __init__(self, capacity: int = 4096, calibration: SpeedCalibration | None = None) -> None:
        if capacity < 1:
            raise ValueError(f"capacity: must be positive, got {capacity}")
        self._calibration, n = calibration, len(_NAMES)
        slowdown, tick_ms = None, TICK_DEADLINE_MS
        if calibration is not None:
            slowdown = calibration.slowdown
            tick_ms = min(TICK_BUDGET_MS * slowdown, TICK_DEADLINE_MS)
        budget_ms = [stage.budget_on(slowdown) for stage in STAGES]
        self._budget_ms, limits_ms = [*budget_ms, tick_ms], [*budget_ms, TICK_DEADLINE_MS]
        self._limit_ns = np.array(
            [_NO_LIMIT if ms is None else round(ms / _MS_PER_NS) for ms in limits_ms]
        )
        # Stages of the tick share its write position, background stages have their own.
        self._spans_ns = np.full((capacity, n), NOT_RUN, dtype=np.int64)
        self._stamps_ns = np.zeros((capacity, n), dtype=np.int64)  # tick: start; background: end
        # Durations of the tick that runs. They are a list, because setting the items of an array
        # one by one takes twice as long; `end_tick` copies it to `_tick_ns`.
        self._current_ns = list(_NOTHING_RAN)
        self._tick_ns = np.array(_NOTHING_RAN)
        self._mask = np.zeros(n, dtype=bool)  # buffer of `end_tick`
        self._overruns = np.zeros(n, dtype=np.int64)
        self._count = np.zeros(n, dtype=np.int64)
        self._drops, self._abandoned = [0] * len(STAGES), [0] * len(STAGES)
        # Start of the tick, moved forward by `exclude_elapsed`; the newest mark; the true start.
        self._begin_ns = self._marked_ns = self._cycle_begin_ns = 0
        self._last_cycle_begin_ns: int | None = None  # `_cycle_begin_ns` of the tick before
        self._durations = Histograms(n, STAGE_BOUNDS_S)
        self._intervals = Histograms(1, INTERVAL_BOUNDS_S)
        self._lock = threading.Lock()

    def begin_tick(self, t_ns: int) -> None:
        """Start a tick. A tick that was not ended is dropped."""
        self._current_ns[:] = _NOTHING_RAN
        self._begin_ns = self._marked_ns = self._cycle_begin_ns = t_ns

    def mark(self, stage: int, t_ns: int) -> None:
        """End a stage: it took the time since the last mark, or since the start of the tick.

        If a stage is marked twice in a tick, its times are added.
        """
        self.span(stage, t_ns - self._marked_ns)
        self._marked_ns = t_ns

    def span(self, stage: int, duration_ns: int) -> None:
        """Add a duration of a stage. The durations of a stage in one tick are added up."""
        if _IN_TICK[stage]:
            before_ns = self._current_ns[stage]
            self._current_ns[stage] = duration_ns if before_ns < 0 else before_ns + duration_ns
        else:
            self._background_span(stage, duration_ns)

    def _background_span(self, stage: int, duration_ns: int) -> None:
        with self._lock:
            i = self._count[stage] % len(self._spans_ns)
            self._spans_ns[i, stage] = duration_ns
            self._stamps_ns[i, stage] = self._marked_ns
            self._count[stage] += 1
            self._overruns[stage] += duration_ns > self._limit_ns[stage]
            self._durations.add_one(stage, duration_ns)

    def exclude_elapsed(self, t_ns: int) -> None:
        """Exclude the time since the last mark from the tick."""
        self._begin_ns += t_ns - self._marked_ns
        self._marked_ns = t_ns

    def end_tick(self, t_ns: int) -> None:
        """End the tick and add it to the ring."""
        self._current_ns[-1] = t_ns - self._begin_ns
        self._tick_ns[:] = self._current_ns
        before_ns, self._last_cycle_begin_ns = self._last_cycle_begin_ns, self._cycle_begin_ns
        with self._lock:
            i = self._count[-1] % len(self._spans_ns)
            self._stamps_ns[i, -1] = self._begin_ns
            np.copyto(self._spans_ns[i], self._tick_ns, where=_IN_TICK_MASK)
            self._overruns += np.greater(self._tick_ns, self._limit_ns, out=self._mask)
            self._count += np.greater_equal(self._tick_ns, 0, out=self._mask)
            self._durations.add(self._current_ns)
            if before_ns is not None:
                self._intervals.add_one(0, self._cycle_begin_ns - before_ns)

    def abandon_tick(self, stage: int) -> None:
        """Count a tick that ended in an error of this stage, as a drop of the stage.

        The tick does not enter the ring, because half a tick would distort the percentiles.
        """
        self._abandoned[stage] += 1

    def set_drops(self, stage: int, total: int) -> None:
        """Set the number of inputs that a stage has dropped since the start, by its own count.

        Abandoned ticks are added to it.
        """
        self._drops[stage] = total

    def report(self, last: int | None = None) -> LatencyReport:
        """Return percentiles over the last `last` ticks and background spans (None: all kept)."""
        with self._lock:
            # By column: the newest ticks. Background stages have their own write positions.
            windows = list(self._spans_ns[self._newest(-1, last)].T)
            for i in _BACKGROUND:
                windows[i] = self._spans_ns[self._newest(i, last), i]
            count, overruns = self._count.tolist(), self._overruns.tolist()
            drops = list(map(sum, zip(self._drops, self._abandoned, strict=True)))
        *rows, tick = (
            StageLatency(name, budget_ms, *_summary(window), n, over, dropped, in_tick)
            for name, budget_ms, window, n, over, dropped, in_tick in zip(
                _NAMES, self._budget_ms, windows, count, overruns, [*drops, sum(drops)], _IN_TICK,
                strict=True,
            )
        )  # fmt: skip
        return LatencyReport(tuple(rows), tick, calibration=self._calibration)

    def histograms(self) -> LatencyHistograms:
        """Return histograms of all ticks and background spans since the start."""
        with self._lock:
            *stages, tick = self._durations.read()
            (interval,) = self._intervals.read()
        return LatencyHistograms(dict(zip(_NAMES, stages, strict=False)), tick, interval)

    def spans(self, after_ns: int = 0) -> list[Span]:
        """Return the kept spans: ticks with their stages, oldest first, then background spans.

        Only ticks that began, and background spans that ended, after `after_ns`.
        """
        with self._lock:
            rows = self._newest(-1, None)
            begins_ns, spans_ns = self._stamps_ns[rows, -1], self._spans_ns[rows]
            background = [(i, self._newest(i, None)) for i in _BACKGROUND]
            # By background stage: its column, and the end and duration of each span.
            ends_ns = [(i, self._stamps_ns[at, i], self._spans_ns[at, i]) for i, at in background]
        wanted = begins_ns > after_ns
        found: list[Span] = []
        for begin_ns, row in zip(
            begins_ns[wanted].tolist(), spans_ns[wanted].tolist(), strict=True
        ):
            found.append(Span(TICK, begin_ns, row[-1], True))
            for name, in_tick, took_ns in zip(_NAMES[:-1], _IN_TICK, row, strict=False):
                if in_tick and took_ns >= 0:
                    found.append(Span(name, begin_ns, took_ns, True))
                    begin_ns += took_ns
        for i, stage_ends_ns, took in ends_ns:
            wanted = stage_ends_ns > after_ns
            for end_ns, took_ns in zip(
                stage_ends_ns[wanted].tolist(), took[wanted].tolist(), strict=True
            ):
                found.append(Span(_NAMES[i], end_ns - took_ns, took_ns, False))
        return found

    def _newest(self, column: int, last: int | None) -> np.ndarray:
        """Return the rows of the newest `last` spans of a column."""
        written, capacity = int(self._count[column]), len(self._spans_ns)
        kept = min(written, capacity)
        take = kept if last is None else max(0, min(last, kept))
        return np.arange(written - take, written) % capacity


def _summary(window_ns: np.ndarray) -> tuple[int, float, float, float, float]:
    """Return (number of spans, p50, p95, p99, max) of the spans that ran, times in ms.

    Percentiles are interpolated linearly. One sort is used for all four. `np.percentile` would sort
    and check its arguments for each.
    """
    spans = np.sort(window_ns[window_ns >= 0])
    n = len(spans)
    if n == 0:
        return 0, 0.0, 0.0, 0.0, 0.0
    position = _QUANTILES * (n - 1)
    low = position.astype(np.int64)
    high = np.minimum(low + 1, n - 1)
    values = spans[low] + (position - low) * (spans[high] - spans[low])
    p50, p95, p99, longest = (values * _MS_PER_NS).tolist()
    return n, p50, p95, p99, longest
