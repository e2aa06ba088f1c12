"""Driving distances for the planner, worked out beside the loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from edge.config import PlannerInOrder, PlannerOwn, PlannerVitl
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.mission.planning.distances import distances

if TYPE_CHECKING:
    from edge.mapping.grid import RollingMap
    from edge.mission.run import MissionRun
    from edge.perception.tracking.instances import InstanceTracker

PERIOD_NS = 1_000_000_000


class Surveyor:
    """One survey at a time, a second after the last at the earliest.

    Args:
        inline: work it out inside `ask`, so that a run replays the same.
    """

    def __init__(self, inline: bool) -> None:
        self._worker = Worker("surveyor", lambda survey: survey(), inline=inline)
        self._asked_ns: int | None = None

    def through(self, beside: Callable[[str, Any], Any]) -> None:
        """Let what the worker is asked and finds pass through `beside`."""
        self._worker = beside("surveyor", self._worker)

    def step(
        self,
        mission: MissionRun,
        grid: RollingMap,
        tracker: InstanceTracker,
        pose: SE2,
        now_ns: int,
    ) -> None:
        """Hand the mission the survey that is there, and begin one where it is due."""
        if (found := self.poll()) is not None and not mission.paused:
            mission.survey(found, now_ns)
        if self.due(now_ns):
            letters = mission.brief.automaton.letters
            places = {name: at for name, at in mission.places.items() if at is not None}
            xy_m = [
                [(places[letter].x_m, places[letter].y_m)]
                if letter in places
                else [one.center_m[:2] for one in tracker.of(letter)]
                for letter in letters
            ]
            known = [np.array(xy, np.float64).reshape(-1, 2) for xy in xy_m]
            self.ask(grid, pose, known, now_ns)

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

        def work() -> np.ndarray:
            return distances(grid.snapshot(inflated=50), (pose.x_m, pose.y_m), positions)

        self._worker.submit(work)

    def poll(self) -> np.ndarray | None:
        """The survey, once, when it is there."""
        return self._worker.poll()

    def forget(self) -> None:
        """The survey under way is of targets that no longer are; its result is not wanted."""
        self._worker.forget()
        self._asked_ns = None

    def close(self) -> None:
        """Begin nothing more; a survey under way is over within a tenth of a second."""
        self._worker.close()


def make_surveyor(
    planner: PlannerVitl | PlannerInOrder | PlannerOwn, inline: bool
) -> Surveyor | None:
    """A surveyor, where metres are what the planner weighs by; else None."""
    if not isinstance(planner, PlannerVitl) or planner.weights != "distance":
        return None
    return Surveyor(inline)
