"""`edge bench --swap NAME`: measure how much a swap of the model slows the loop, while it runs.

The table compares two spans of time: before the swap, and from its request to its end.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from edge.errors import UserError
from edge.perception.swap.base import FINAL_STATES

if TYPE_CHECKING:
    from edge.loop.runner import RunningService


# Figure → its name in the table, and its format.
_ROWS = {
    "seconds": ("seconds", ".1f"),
    "ticks": ("ticks", "d"),
    "lost": ("ticks lost", "d"),
    "let_go": ("observations skipped", "d"),
    "images": ("images detected in", "d"),
    "p50_ms": ("tick p50 ms", ".2f"),
    "p99_ms": ("tick p99 ms", ".2f"),
    "max_ms": ("tick max ms", ".2f"),
    "longest_ms": ("longest iteration ms", ".1f"),
}
"""`lost` counts ticks that the loop missed: entire periods between two of its iterations. `let_go`
counts observations that a newer one replaced before a tick used them."""


class SwapBench:
    """A request for the swap at half time, with measurements of the loop before and during it."""

    def __init__(self, running: RunningService, model: str, seconds: float) -> None:
        from edge.perception.runtime.cards import load_detector_card

        self._running = running
        self._model = load_detector_card(model).name
        self._half_s = seconds / 2
        self._period_ns = int(1e9 / running.config.loop.hz)
        self._first_ns = self._last_ns = 0  # ends of the first and of the newest iteration
        # Of the present span: start, longest iteration, ticks lost, `_counts` at the start.
        self._since_ns = self._longest_ns = self._lost = 0
        self._counts_before: tuple[int, int, int] = (0, 0, 0)
        # Figures of both spans (keys of `_ROWS`), empty until the span has ended.
        self._before: dict[str, Any] = {}
        self._during: dict[str, Any] = {}

    def after_iteration(self) -> None:
        """Record the end of an iteration of the loop; request the swap, or record its end."""
        if self._during or not self._running.source.counters.get("observations"):
            return  # the swap has ended, or the measurement has not begun
        now_ns = time.monotonic_ns()
        if not self._first_ns:
            self._first_ns = self._last_ns = now_ns
            self._begin_span(now_ns)
        gap_ns, self._last_ns = now_ns - self._last_ns, now_ns
        self._longest_ns = max(self._longest_ns, gap_ns)
        self._lost += max(0, gap_ns // self._period_ns - 1)
        swapper = self._running.service.detector_swap
        if not self._before:
            if now_ns - self._first_ns >= self._half_s * 1e9:
                self._before = self._end_span(now_ns)
                self._begin_span(now_ns)
                swapper.request(self._model, False, now_ns)  # not forced: it may be refused
        elif swapper.state in FINAL_STATES:
            self._during = self._end_span(now_ns)

    def figures(self) -> dict[str, Any]:
        """Return the swap's outcome and both time spans, ready for JSON.

        Raises:
            UserError: the swap did not end.
        """
        swap = self._running.service.detector_swap.status()
        if not self._during:
            raise UserError(
                f"bench: --swap: the swap to {self._model} was not complete at the end (state: "
                f"{swap['state']}); give a larger number of --seconds"
            )
        return {**swap, "before": self._before, "during": self._during}

    def _begin_span(self, now_ns: int) -> None:
        """Start to count for a new span of time."""
        self._since_ns, self._counts_before = now_ns, self._counts()
        self._longest_ns = self._lost = 0

    def _end_span(self, now_ns: int) -> dict[str, Any]:
        """Return the figures of the span that ends now, with the keys of `_ROWS`."""
        ticks, let_go, images = (
            now - was for now, was in zip(self._counts(), self._counts_before, strict=True)
        )
        tick = self._running.service.latency.report(last=ticks).tick
        return {
            "seconds": (now_ns - self._since_ns) * 1e-9, "ticks": ticks, "lost": self._lost,
            "let_go": let_go, "longest_ms": self._longest_ns * 1e-6, "p50_ms": tick.p50_ms,
            "p99_ms": tick.p99_ms, "max_ms": tick.max_ms, "images": images,
        }  # fmt: skip

    def _counts(self) -> tuple[int, int, int]:
        """Return the numbers of observations used, of observations replaced, and of images."""
        counters: Mapping[str, int] = self._running.source.counters
        return (
            counters.get("observations", 0), counters.get("superseded", 0),
            self._running.worker.stats.done,
        )  # fmt: skip


def verdicts(figures: Mapping[str, Any]) -> dict[str, tuple[float, str, float]]:
    """Return figures of a swap as (value, unit, limit) by name, for `run_bench`.

    The new model must stay, and no tick may be lost.
    """
    return {
        "swaps given up": (float(figures["state"] != "kept"), "", 0.0),
        "ticks lost by the swap": (float(figures["during"]["lost"]), "", 0.0),
    }


def table(figures: Mapping[str, Any]) -> str:
    """Return the result of `SwapBench.figures` as an aligned table."""
    lines = [
        f"swap of {figures['previous']} to {figures['model']}: "
        f"{figures['state']}: {figures['detail']}",
        f"{'':22}{'before':>12}{'during':>12}",
    ]
    for key, (name, form) in _ROWS.items():
        cells = (f"{format(figures[part][key], form):>12}" for part in ("before", "during"))
        lines.append(f"{name:22}{''.join(cells)}")
    return "\n".join(lines)
