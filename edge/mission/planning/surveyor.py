"""Driving distances for the planner, worked out beside the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edge.geometry import SE2
from edge.host.worker import Worker
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
        self._worker = Worker("surveyor", lambda survey: survey(), inline=inline)
        self._asked_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether it is time for another survey."""
        rested = self._asked_ns is None or now_ns - self._asked_ns >= PERIOD_NS
        return rested and self._worker.idle

    def ask(self, grid: RollingMap, pose: SE2, positions: list[np.ndarray], now_ns: int) -> None:
        """Begin a survey.

        Args:
            positions: for each letter of the automaton the (m, 2) positions of its known instances.
        """
        self._asked_ns = now_ns

        def survey() -> np.ndarray:
            here = (pose.x_m, pose.y_m)
            return distances(grid.snapshot(inflated=50), here, positions)

        self._worker.submit(survey)

    def poll(self) -> np.ndarray | None:
        """The distances, once, when they are there: see `Knowledge.distance_m`."""
        return self._worker.poll()

    def forget(self) -> None:
        """The survey under way is of targets that no longer are; its result is not wanted."""
        self._worker.forget()
        self._asked_ns = None

    def close(self) -> None:
        """Begin nothing more; a survey under way is over within a tenth of a second."""
        self._worker.close()
