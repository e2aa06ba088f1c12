"""A sink that tells, once a second, how evenly the loop goes."""

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
PERIOD_S = 1.0
_CLOSE_S = 1.0


class BeatSink:
    """Publishes JSON at `KEY`, below the prefix: of the last second `ticks`, `beats` (with those
    that found nothing to see) and p50, p99 and the longest of what lies between two ticks
    (`interval_ms`) or beats (`gap_ms`), and of what a tick takes (`tick_ms`).
    """

    def __init__(
        self,
        config: Config,
        session: zenoh.Session,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._clock = clock
        self._publisher = session.declare_publisher(config.zenoh.key(KEY))
        self._worker = Worker("beat", self._publisher.put)
        self._began_s = self._beat_s = self._tick_s = clock()
        self._intervals_s: list[float] = []
        self._gaps_s: list[float] = []

    def tick(self, result: TickResult) -> None:
        """See `edge.loop.result.Sink`."""
        now_s = self._clock()
        self._gaps_s.append(now_s - self._beat_s)
        self._beat_s = now_s
        if result.observation is not None:
            self._intervals_s.append(now_s - self._tick_s)
            self._tick_s = now_s
        if now_s - self._began_s >= PERIOD_S:
            self._worker.submit(json.dumps(self._told(result, now_s - self._began_s)).encode())
            self._began_s, self._intervals_s, self._gaps_s = now_s, [], []

    def _told(self, result: TickResult, passed_s: float) -> dict[str, object]:
        ticks = len(self._intervals_s)
        tick = result.latency(last=ticks).tick
        return {
            "seconds": round(passed_s, 3),
            "ticks": ticks,
            "beats": len(self._gaps_s),
            "interval_ms": _three(self._intervals_s),
            "gap_ms": _three(self._gaps_s),
            "tick_ms": [round(v, 3) for v in (tick.p50_ms, tick.p99_ms, tick.max_ms)],
        }

    def close(self) -> None:
        if self._worker.close(_CLOSE_S):
            self._publisher.undeclare()


def _three(values_s: list[float]) -> list[float] | None:
    """p50, p99 and the longest, in ms; None of nothing."""
    if not values_s:
        return None
    return [round(1e3 * float(v), 3) for v in np.percentile(values_s, (50, 99, 100))]
