"""Sink of a soaked service that publishes the jitter of its loop once a second.

A beat is one result of the loop, with or without an observation. A tick has an observation.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
import zenoh

from edge.config import Config
from edge.host.worker import Worker
from edge.loop.result import TickResult

KEY = "soak/beat"
PERIOD_S = 1.0  # time between two messages
_CLOSE_S = 1.0  # longest wait for the last message at the end


class JitterSink:
    """Publishes JSON at `KEY`, below the prefix, about the last second.

    `ticks` is the number of ticks and `beats` the number of beats. `interval_ms` is the time
    between two ticks, `gap_ms` between two beats, and `tick_ms` the duration of a tick: each as
    p50, p99 and maximum.
    """

    def __init__(
        self, config: Config, session: zenoh.Session, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._clock = clock
        self._publisher = session.declare_publisher(config.zenoh.key(KEY))
        self._worker = Worker("beat", self._publisher.put)
        self._began_s = self._beat_s = self._tick_s = clock()
        self._intervals_s: list[float] = []
        self._gaps_s: list[float] = []

    def tick(self, result: TickResult) -> None:
        now_s = self._clock()
        self._gaps_s.append(now_s - self._beat_s)
        self._beat_s = now_s
        if result.observation is not None:
            self._intervals_s.append(now_s - self._tick_s)
            self._tick_s = now_s
        if now_s - self._began_s >= PERIOD_S:
            self._worker.submit(json.dumps(self._message(result, now_s - self._began_s)).encode())
            self._began_s, self._intervals_s, self._gaps_s = now_s, [], []

    def _message(self, result: TickResult, period_s: float) -> dict[str, object]:
        ticks = len(self._intervals_s)
        tick = result.latency(last=ticks).tick
        return {
            "seconds": round(period_s, 3),
            "ticks": ticks,
            "beats": len(self._gaps_s),
            "interval_ms": _percentiles_ms(self._intervals_s),
            "gap_ms": _percentiles_ms(self._gaps_s),
            "tick_ms": [round(v, 3) for v in (tick.p50_ms, tick.p99_ms, tick.max_ms)],
        }

    def close(self) -> None:
        """Stop the publisher."""
        if self._worker.close(_CLOSE_S):
            self._publisher.undeclare()


def _percentiles_ms(values_s: list[float]) -> list[float] | None:
    """Return p50, p99 and maximum in ms; None without values."""
    if not values_s:
        return None
    return [round(1e3 * float(v), 3) for v in np.percentile(values_s, (50, 99, 100))]
