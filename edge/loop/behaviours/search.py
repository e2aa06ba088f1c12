"""Search: look for the active target, and go to it (VL-Nav alg. 2, ViTL alg. 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.config import Config
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mission.run import MissionRun
from edge.mission.surveyor import Surveyor
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import Context
from edge.types import Goal, Instance


class SearchBehaviour:
    """Go to the best candidate: a frontier, or an object that may be the active target.

    Args:
        surveyor: measures distances between targets, if the planner weighs by them.
    """

    searching = True

    def __init__(
        self,
        mission: MissionRun,
        config: Config,
        here: SemanticMap,
        goals: GoalTracker,
        surveyor: Surveyor | None,
    ) -> None:
        self._mission, self._config = mission, config
        self._map, self._goals, self._surveyor = here, goals, surveyor

    def gather(self) -> Sequence[Instance]:
        """Return the objects of the active target."""
        if self._mission.done:
            return ()
        sure, doubted = not self._config.policy.instances, self._goals.searched
        return self._map.tracker.of(self._mission.target, sure, doubted=doubted)

    def plan(self, context: Context, images: int) -> None:
        """Judge the goal, and give up a target that was searched for everywhere."""
        mission, grid, goals = self._mission, self._map.grid, self._goals
        pose, now_ns = context.pose, context.now_ns
        sure = not self._config.policy.instances
        mission.see(newest_ids(self._map.tracker, mission.brief.targets, sure), now_ns)
        if self._surveyor is not None:
            self._surveyor.step(mission, grid, self._map.tracker, pose, now_ns)
        if goals.follows(mission) and mission.active:
            goals.judge(grid, pose, mission, images, now_ns)
            if goals.exhausted:
                mission.give_up(goals.why_in_vain(mission, grid), now_ns)

    def select(self, context: Context, scores: np.ndarray, images: int) -> Goal | None:
        """Choose by score."""
        return self._goals.choose(context, self._map.grid, scores, images)

    def facts(self) -> None:
        """Return None: no trajectory is followed."""

    def reconfigure(self, config: Config) -> None:
        self._config = config

    def forget(self) -> None:
        """Do nothing: map and goals hold all that depends on the frame."""

    def close(self) -> None:
        """Do nothing: the surveyor belongs to the service."""


def newest_ids(
    tracker: InstanceTracker, targets: Sequence[str], sure: bool, doubted: bool = True
) -> dict[str, int]:
    """Return the highest object id for each target of which an object is known."""
    known = {label: tracker.of(label, sure, doubted) for label in targets}
    return {label: max(i.id for i in found) for label, found in known.items() if found}
