"""Pursuits: how the robot pursues one target of a mission, by the kind of the target.

`PURSUITS` has one class for each kind of destination. Another kind needs a class and a line there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.config import Config
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mission.destinations import Destination, ExploreTarget, PlaceTarget, WaitTarget, shown_s
from edge.mission.run import MissionRun
from edge.policies.base import PolicyInput
from edge.types import Goal, Instance


class Pursuit:
    """Pursuit of a thing: search for it, and go to it. Base class of the others.

    Args:
        mission: The mission.
        config: The configuration.
        here: The semantic map.
        goals: The goal tracker.
    """

    def __init__(
        self, mission: MissionRun, config: Config, here: SemanticMap, goals: GoalTracker
    ) -> None:
        self._mission, self._config, self._map, self._goals = mission, config, here, goals

    def gather(self) -> Sequence[Instance]:
        """Return the objects that are candidates for this target."""
        sure, doubted = not self._config.policy.instances, self._goals.searched
        return self._map.tracker.of(self._mission.target, sure, doubted=doubted)

    def judge(self, context: PolicyInput, images: int) -> None:
        """Check the goal, then the end of the target; see `Behaviour.plan`."""
        turns, grid = self._mission.turns, self._map.grid
        self._goals.judge(grid, context.pose, self._mission, images, context.now_ns)
        same = self._mission.turns == turns and not self._mission.done
        if same and self._goals.exhausted:
            self.finish(context.now_ns)

    def finish(self, now_ns: int) -> None:
        """End the target: no candidate is left."""
        self._mission.give_up(self._goals.failure_reason(self._mission, self._map.grid), now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        """Return the goal of this tick; see `Behaviour.select`."""
        return self._goals.choose(context, self._map.grid, scores, images)


class PlacePursuit(Pursuit):
    """Pursuit of a place: go to its pose."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        target = self._mission.target
        place = self._mission.destinations[target]
        assert isinstance(place, PlaceTarget)
        assert place.pose is not None  # set by `locate`
        return self._goals.go_to_place(context, self._map.grid, place.pose, target, images)


class ExplorePursuit(Pursuit):
    """Exploration until no frontier is left, or for some time."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def judge(self, context: PolicyInput, images: int) -> None:
        mission = self._mission
        task = mission.destinations[mission.target]
        assert isinstance(task, ExploreTarget)
        if task.limit_s is not None:
            left_s = task.limit_s - mission.pursued_now_s
            if left_s <= 0:
                self.finish(context.now_ns)
                return
            mission.activity = f"exploring, {shown_s(np.ceil(left_s))} left"
        super().judge(context, images)

    def finish(self, now_ns: int) -> None:
        self._mission.on_reached(f"{self._map.grid.known_m2:.0f} m² are known", now_ns)


class WaitPursuit(Pursuit):
    """Wait where the robot is."""

    def gather(self) -> Sequence[Instance]:
        return ()

    def judge(self, context: PolicyInput, images: int) -> None:
        mission = self._mission
        task = mission.destinations[mission.target]
        assert isinstance(task, WaitTarget)
        self._goals.phase = "waiting"
        if task.seconds is None:
            mission.activity = "waiting until told to go on"
            return
        left_s = task.seconds - mission.pursued_now_s
        mission.activity = f"waiting, {shown_s(np.ceil(left_s))} left"
        if left_s <= 0:
            mission.on_reached(f"waited {shown_s(task.seconds)}", context.now_ns)

    def select(self, context: PolicyInput, scores: np.ndarray, images: int) -> Goal | None:
        self._goals.rest()
        return None


PURSUITS: dict[type[Destination] | None, type[Pursuit]] = {
    None: Pursuit,
    PlaceTarget: PlacePursuit,
    ExploreTarget: ExplorePursuit,
    WaitTarget: WaitPursuit,
}
"""The pursuit of each kind of destination; that of `None` is for things."""
