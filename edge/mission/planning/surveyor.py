"""Driving distances for the planner, worked out beside the loop."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from edge.geometry import SE2
from edge.mission.planning.distances import distances

if TYPE_CHECKING:
    from edge.mapping.grid import RollingMap

PERIOD_NS = 1_000_000_000


class Surveyor:
    """One survey at a time, a second after the last at the earliest.

    Args:
        inline: work it out inside `ask`, so that a run replays the same.
    """

    def __init__(self, inline: bool) -> None:
        self._pool = None if inline else ThreadPoolExecutor(1, thread_name_prefix="surveyor")
        self._future: Future[np.ndarray] | None = None
        self._asked_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether `ask` would begin a survey now."""
        if self._future is not None:
            return False
        return self._asked_ns is None or now_ns - self._asked_ns >= PERIOD_NS

    def ask(self, grid: RollingMap, pose: SE2, places: list[np.ndarray], now_ns: int) -> None:
        """Begin a survey.

        Args:
            places: for each letter of the automaton the (m, 2) positions of its known instances.
        """
        self._asked_ns = now_ns

        def survey() -> np.ndarray:
            return distances(grid.snapshot(inflated=50), (pose.x_m, pose.y_m), places)

        if self._pool is not None:
            self._future = self._pool.submit(survey)
        else:
            self._future = Future()
            self._future.set_result(survey())

    def poll(self) -> np.ndarray | None:
        """The distances, once, when they are there: see `Knowledge.distance_m`."""
        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        return future.result()

    def forget(self) -> None:
        """The survey under way is of targets that no longer are; its result is not wanted."""
        self._future = self._asked_ns = None

    def close(self) -> None:
        """Begin nothing more; a survey under way is over within a tenth of a second."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
