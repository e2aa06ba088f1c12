"""Driving distances and expected searches for the planner, worked out beside the loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from edge.config import PlannerExpected, PlannerInOrder, PlannerOwn, PlannerVitl
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.mission.planning.belief import Prospects, Survey, survey
from edge.mission.planning.distances import distances

if TYPE_CHECKING:
    from edge.mapping.grid import RollingMap
    from edge.mission.run import MissionRun
    from edge.perception.instances import InstanceTracker

PERIOD_NS = 1_000_000_000


class Surveyor:
    """One survey at a time, a second after the last at the earliest.

    Args:
        inline: work it out inside `ask`, so that a run replays the same.
        explore_m: see `survey`; None: searches are not surveyed.
    """

    def __init__(self, inline: bool, explore_m: float | None = None) -> None:
        self._explore_m = explore_m
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
        prospects: Callable[[Sequence[str]], Prospects],
        pose: SE2,
        now_ns: int,
    ) -> None:
        """Hand the mission the survey that is there, and begin one where it is due.

        Args:
            prospects: where a search for letters may go on.
        """
        if (found := self.poll()) is not None and not mission.paused:
            mission.survey(found, now_ns)
        if self.due(now_ns):
            letters = mission.brief.automaton.letters
            xy_m = [[one.center_m[:2] for one in tracker.of(letter)] for letter in letters]
            known = [np.array(xy, np.float64).reshape(-1, 2) for xy in xy_m]
            searched = self._explore_m is not None
            self.ask(grid, pose, known, now_ns, prospects(letters) if searched else None)

    def due(self, now_ns: int) -> bool:
        """Whether it is time for another survey."""
        rested = self._asked_ns is None or now_ns - self._asked_ns >= PERIOD_NS
        return rested and self._worker.idle

    def ask(
        self,
        grid: RollingMap,
        pose: SE2,
        positions: list[np.ndarray],
        now_ns: int,
        prospects: Prospects | None = None,
    ) -> None:
        """Begin a survey.

        Args:
            positions: for each letter of the automaton the (m, 2) positions of its known instances.
            prospects: where a search may go on; None: only distances are wanted.
        """
        self._asked_ns = now_ns

        def work() -> Survey:
            snapshot = grid.snapshot(inflated=50)
            if prospects is None:
                return Survey(distances(snapshot, (pose.x_m, pose.y_m), positions))
            return survey(snapshot, pose, positions, prospects, self._explore_m)

        self._worker.submit(work)

    def poll(self) -> Survey | None:
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
    planner: PlannerVitl | PlannerExpected | PlannerInOrder | PlannerOwn, inline: bool
) -> Surveyor | None:
    """A surveyor, where metres are what the planner weighs by; else None."""
    if not isinstance(planner, (PlannerVitl, PlannerExpected)) or planner.weights != "distance":
        return None
    searched = isinstance(planner, PlannerExpected)
    return Surveyor(inline, planner.explore_m if searched else None)
