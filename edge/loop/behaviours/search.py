"""Search behaviour: explore, find the active target and go to it (VL-Nav alg. 2, ViTL alg. 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.config import Config
from edge.geometry import SE2
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.travel_cost import TravelCostEstimator
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import PolicyInput
from edge.types import Goal, Instance


class SearchBehaviour:
    """A behaviour that goes to the best candidate: a frontier or an object of the active target.

    Args:
        mission: The mission.
        config: The configuration.
        here: The semantic map.
        goals: The goal tracker.
        surveyor: Estimates travel costs between targets; None if the planner does not use them.
    """

    searching = True

    def __init__(
        self,
        mission: MissionRun,
        config: Config,
        here: SemanticMap,
        goals: GoalTracker,
        surveyor: TravelCostEstimator | None,
    ) -> None:
        self._mission, self._config = mission, config
        self._map, self._goals, self._surveyor = here, goals, surveyor
        self._things = tuple(t for t in mission.brief.targets if t not in mission.places)

    @property
    def _place(self) -> SE2 | None:
        """The active target's pose if it is a place; None for a thing, and for exploring."""
        return self._mission.places.get(self._mission.target)

    def gather(self) -> Sequence[Instance]:
        """Return the objects of the active target; a place has none."""
        if self._mission.done or self._mission.target in self._mission.places:
            return ()
        sure, doubted = not self._config.policy.instances, self._goals.searched
        return self._map.tracker.of(self._mission.target, sure, doubted=doubted)

    def plan(self, context: PolicyInput, images: int) -> None:
        """Check the goal; fail the target if the search for it is exhausted."""
        mission, grid, goals = self._mission, self._map.grid, self._goals
        pose, now_ns = context.pose, context.now_ns
        sure = not self._config.policy.instances
        seen = newest_ids(self._map.tracker, self._things, sure)
        mission.see(seen | dict.fromkeys(mission.places, 0), now_ns)
        if self._surveyor is not None:
            self._surveyor.step(mission, grid, self._map.tracker, pose, now_ns)
        if goals.follows(mission) and mission.active:
            goals.judge(grid, pose, mission, images, now_ns)
            if goals.exhausted and mission.target in mission.places and self._place is None:
                mission.on_reached(f"{grid.known_m2:.0f} m² are known", now_ns)
            elif goals.exhausted:
                mission.give_up(goals.failure_reason(mission, grid), now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Choose the goal by the candidates' scores, or go to the place."""
        if (place := self._place) is not None:
            target, grid = self._mission.target, self._map.grid
            return self._goals.go_to_place(context, grid, place, target, images)
        return self._goals.choose(context, self._map.grid, scores, images)

    def facts(self) -> None:
        """Return None, since there is no trajectory."""

    def reconfigure(self, config: Config) -> None:
        self._config = config

    def forget(self) -> None:
        """Do nothing: the map and the goal tracker hold all data in the frame."""

    def close(self) -> None:
        """Do nothing: the surveyor belongs to the service."""


def newest_ids(
    tracker: InstanceTracker, targets: Sequence[str], sure: bool, doubted: bool = True
) -> dict[str, int]:
    """Return the highest object id of each target that has a known object.

    Args:
        tracker: The instance tracker.
        targets: The targets.
        sure: Count only confirmed objects.
        doubted: Count objects that were more often detected as another class, too.
    """
    known = {label: tracker.of(label, sure, doubted) for label in targets}
    return {label: max(i.id for i in found) for label, found in known.items() if found}
