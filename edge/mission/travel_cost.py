"""Driving distances between the targets of a mission, computed in the background.

A survey is one such computation. The planner uses the distances as weights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from edge.config import PlannerInOrder, PlannerPlugin, PlannerVitl
from edge.geometry import SE2
from edge.host.worker import Worker
from edge.mission.planning.distances import distances

if TYPE_CHECKING:
    from edge.mapping.grid import RollingMap
    from edge.mission.run import MissionRun

PERIOD_NS = 1_000_000_000
"""Least time between the starts of two surveys."""


class TravelCostEstimator:
    """Background computation of surveys: one at a time, at most one a second.

    Args:
        inline: compute inside `step`, so that a replay gives identical results.
    """

    def __init__(self, inline: bool) -> None:
        self._worker = Worker("travel_cost", lambda survey: survey(), inline=inline)
        self._requested_ns: int | None = None

    def wrap_workers(self, wrap: Callable[[str, Any], Any]) -> None:
        """Wrap the worker so that its inputs and results are logged or replayed by `wrap`."""
        self._worker = wrap("travel_cost", self._worker)

    def step(
        self,
        mission: MissionRun,
        grid: RollingMap,
        positions_of: Callable[[str], Iterable[Sequence[float]]],
        pose: SE2,
        now_ns: int,
    ) -> None:
        """Pass a finished survey to the mission, and start another one if it is due.

        Args:
            mission: the mission.
            grid: the map.
            positions_of: returns the known positions (x, y) of a target, each one enough to reach.
            pose: pose of the robot.
            now_ns: loop time.
        """
        distance_m = self._worker.poll()  # see `MissionKnowledge.distance_m`
        if distance_m is not None and not (mission.done or mission.paused):
            mission.sets.distance_m = distance_m
            mission.replan(now_ns)
        is_time = self._requested_ns is None or now_ns - self._requested_ns >= PERIOD_NS
        if not is_time or not self._worker.idle:
            return
        self._requested_ns = now_ns
        positions = [
            np.array(list(positions_of(name)), np.float64).reshape(-1, 2)
            for name in mission.spec.automaton.propositions
        ]

        def survey() -> np.ndarray:
            # Cells that are too near to an obstacle for the robot get the value 50.
            return distances(grid.snapshot(inflated=50), (pose.x_m, pose.y_m), positions)

        self._worker.submit(survey)

    def discard_pending(self) -> None:
        """Discard the running survey because its targets have changed."""
        self._worker.discard_all()
        self._requested_ns = None

    def close(self) -> None:
        """Stop; a running survey ends within 0.1 s."""
        self._worker.close()


def make_travel_cost_estimator(
    planner: PlannerVitl | PlannerInOrder | PlannerPlugin, inline: bool
) -> TravelCostEstimator | None:
    """Return an estimator if the planner uses distances as weights, else None."""
    if not isinstance(planner, PlannerVitl) or planner.weights != "distance":
        return None
    return TravelCostEstimator(inline)
